"""What the paper and the loop set out to show, and whether the results show it."""
