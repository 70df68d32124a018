"""Kernels for the CPU, compiled by numba, which work on a sensor row at a time."""
