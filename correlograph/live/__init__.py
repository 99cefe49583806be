"""Live view: frames of a running camera, what they contain so far, and a local page that shows it.

sources.py   frames from a folder or file that grows, from a simulated scene, or from any object that yields frames
frame_report.py  values measured on one frame
session.py   running estimate, reconstruction and saved frames
film.py      reconstructions in order, and the path of an object that moves
threads.py   threads that read, add and reconstruct
page.py      the page, for one browser on this machine
"""
