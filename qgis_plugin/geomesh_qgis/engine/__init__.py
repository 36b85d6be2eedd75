"""The geomesh that the plugin runs: found, installed, tried out, and run. No QGIS, no Qt."""
