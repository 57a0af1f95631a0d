"""Detects accelerator errors after which only a new process helps."""

from __future__ import annotations

#: Words from errors of CUDA, cuBLAS, cuDNN, HIP and PyTorch. The gateway has the same list in
#: policy-gateway/src/health.rs, and sends only probes to a server after such an error.
BROKEN_WORDS = (
    "cuda error", "cuda runtime error", "cublas_status", "cudnn_status", "hip error",
    "device-side assert", "illegal memory access", "out of memory",
)  # fmt: skip


def is_broken(error: BaseException) -> bool:
    """Returns True if a retry in this process cannot succeed."""
    text = f"{type(error).__name__}: {error}".lower()
    return any(words in text for words in BROKEN_WORDS)
