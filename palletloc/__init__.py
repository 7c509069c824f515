"""Find pallets on shelves in 360-degree shots and measure their poses, one shot at a time."""

__version__ = "0.1.0"

__all__ = ["__version__"]
