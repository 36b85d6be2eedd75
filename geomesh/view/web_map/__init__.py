"""The web map: a mesh as one HTML page that opens from disk, without any network."""
