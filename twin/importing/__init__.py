"""Data from where it is: foreign files as tables of named channels, and the map that says which becomes what.

One file per format, each with ``read(path)`` → tables. A format's library is imported when a file of it is read.
"""
