"""Kernels of binned readings for a GPU, written in Triton, which compute each pixel by itself.

They read the records of `engine.lower`, as those of the CPU do, uploaded by `arrays`. No kernel
uses Triton's own library of compiled functions, such as `tl.sum`: they run on the CPU, by Triton's
interpreter, only if it is chosen before Triton is first imported.
"""
