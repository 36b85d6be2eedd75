"""The area that a mesh covers: its outline, traced and simplified to loops."""
