"""How kernels are compiled and cached. Kernels are in the folders named `kernels`."""
