"""Files: frames, captures, pictures, results.

    capture.py         frames with the facts of their camera, in memory
    capture_folder.py  the folder of them, replaced as a whole
    frames.py          EXR frames with their header (exr_version.py: one attribute of it)
    pictures.py        monochrome pictures and arrays of any kind
    output.py          folders and files, never half-written
"""
