"""What one unit measured."""
