"""The triangle mesh: topology, measures, certificate and attributes."""
