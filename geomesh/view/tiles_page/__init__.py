"""A page that shows the tiles of a mesh: see `geomesh.view.tiles_page.page`."""
