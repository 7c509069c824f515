"""What planned targets will give, before anyone drives."""
