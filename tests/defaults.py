"""Other defaults of torch's than the usual ones, for the tests that no result depends on them."""

import contextlib

import torch

DTYPES = (torch.float64, torch.bfloat16)  # wider and narrower


@contextlib.contextmanager
def defaults(dtype, device="meta"):
    """Make a dtype torch's default, and a device: on "meta", tensors have no values to go on
    with."""
    usual = torch.get_default_dtype()
    torch.set_default_dtype(dtype)
    try:
        with torch.device(device):
            yield
    finally:
        torch.set_default_dtype(usual)
