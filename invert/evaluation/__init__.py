"""Comparison of methods: the command `invert.evaluate`.

evaluate.py        every method on every level of a test set; resumes where it stopped
cells.py           scores and pictures of one method on one level, on disk
sets.py            edges, unseen characters, rendered and measured captures
identification.py  which character a reconstruction shows
report.py          tables, pictures, accuracy against time
"""
