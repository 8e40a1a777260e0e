"""Messages of the log.

Written by hand: the definitions in ``msg/*.msg``, the levels of events in ``events.py``, the names of
records in ``names.py``, and ``controller_rows.py``, which fills the rows of a tick. ``schemas.py`` and
``rows.py`` make types and rows from the definitions; ``rows.pyi`` is generated.
"""
