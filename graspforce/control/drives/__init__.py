"""Commands for the drives of a hand, and the margin that their errors leave."""
