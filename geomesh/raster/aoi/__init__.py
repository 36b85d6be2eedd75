"""Areas of interest: whatever is given becomes the pixels whose centres lie in it."""
