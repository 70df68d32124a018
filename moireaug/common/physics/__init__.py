"""Each formula that the reference and the kernels share, written once: scalar functions without
control flow, over operations that `binding.bind` gives them from a library of arrays, or of
compiled numbers.

As they are, they take numbers and arrays of numpy. The order of their sums and products is that of
the CPU's kernels: another order rounds differently.
"""
