"""What a drive past targets tells of the mounting."""
