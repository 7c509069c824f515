"""Printed targets and what shots show of them."""
