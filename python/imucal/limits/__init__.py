"""What a unit must keep, and how it does."""
