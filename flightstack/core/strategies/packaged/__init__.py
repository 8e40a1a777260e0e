"""Filters of the package: the class ``NameFilter`` in ``name.py`` is the filter ``name``."""
