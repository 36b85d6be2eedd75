"""The Processing algorithms, one file for each."""
