"""Laws: formulas for residuals that no effect of the catalogue describes."""
