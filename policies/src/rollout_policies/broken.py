"""Errors of an accelerator from which only a new process recovers."""

from __future__ import annotations

#: Words of CUDA, cuBLAS, cuDNN, HIP and PyTorch; the same as in the gateway's
#: policy-gateway/src/health.rs, which takes such a server out at once.
BROKEN_WORDS = (
    "cuda error",
    "cuda runtime error",
    "cublas_status",
    "cudnn_status",
    "hip error",
    "device-side assert",
    "illegal memory access",
    "out of memory",
)


def is_broken(error: BaseException) -> bool:
    """Whether asking again in this process is in vain."""
    text = f"{type(error).__name__}: {error}".lower()
    return any(words in text for words in BROKEN_WORDS)
