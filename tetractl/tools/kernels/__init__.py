"""The compilation and the cache of kernels, which are the functions in folders named `kernels`."""
