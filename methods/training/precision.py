"""The precision that networks are trained in."""

from __future__ import annotations

import torch


def working_precision(device: str) -> torch.autocast:
    """bfloat16 where a kind of device computes in it; float32 elsewhere.

    Processors without it take 15 times as long. Results of the two differ by rounding, so that one
    seed makes one result on one kind of machine.
    """
    return torch.autocast(device, dtype=torch.bfloat16, enabled=_has_bfloat16(device))


def _has_bfloat16(device: str) -> bool:
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    able = torch.cpu.get_capabilities()
    return bool(able.get("amx_bf16") or able.get("avx512_bf16"))
