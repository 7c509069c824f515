"""Lens models as functions of their parameters, with derivatives, and their fit to boards."""
