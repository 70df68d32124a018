"""The lowering: from a Shot to the records of plain numbers and arrays that kernels take, in numpy
on the host. What depends only on the scene and the size is cached."""
