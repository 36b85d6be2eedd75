"""Find, install, test and run the geomesh that the plugin uses. Needs no QGIS and no Qt."""

# The page of the settings to which messages refer.
OPTIONS = "Settings > Options > geomesh"

# The preset that the dialogs start with. A test compiles what it needs.
DEFAULT_PRESET = "adaptive"
