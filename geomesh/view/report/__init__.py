"""The report of a mesh: one page to read and to print, without anything from outside.

`write.py` writes it. `errors.py`, `settings.py`, `statements.py`, `worst.py`, `again.py`,
`histograms.py`, `pictures.py` and `beside.py` each find one part of its content, which is in the
value objects of `content.py`; `page.py` turns these into HTML.
"""
