"""The page Settings > Options > geomesh."""
