"""Comparison of methods: the command `invert.evaluate`.

evaluate.py        every method on every level of a test set; resumable
cells.py           scores and images of one method on one level, on disk
sets.py            edges, unseen characters, grey objects, rendered and measured captures
identification.py  identification of the character that a reconstruction shows
report.py          tables, figures, accuracy against time
"""
