"""Laws: formulas for what the catalogue does not describe."""
