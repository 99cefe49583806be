"""Compiler library and computing back end (variant) of Mitsuba.

libllvm.py   selection of the libLLVM that Dr.Jit loads
variant.py   selection of the Mitsuba variant; plugins that it can compile
"""
