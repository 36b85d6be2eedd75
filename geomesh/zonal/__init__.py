"""Which pixels a triangle holds, and their statistics."""
