"""Lanes on a GPU: the same program as on a CPU, one lane a thread, by LLVM's NVPTX back end and the CUDA driver."""
