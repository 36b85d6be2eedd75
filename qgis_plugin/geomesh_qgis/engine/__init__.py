"""The geomesh that the plugin runs: found, installed, tried out, and run. No QGIS, no Qt."""

# Where the user looks after it: what messages point to.
OPTIONS = "Settings > Options > geomesh"
