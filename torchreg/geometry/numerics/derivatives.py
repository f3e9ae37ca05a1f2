"""Whether a derivative may be wanted; where it is not, the work that serves derivatives alone is left out."""

from __future__ import annotations

import torch
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor
from torch.autograd import forward_ad


def derivative_wanted(*values: Tensor) -> bool:
    """Whether a derivative with respect to one of these tensors may be wanted, backward or forward.

    Inside ``torch.func`` transforms the answer is yes: a tensor mapped over by ``vmap`` does not know that it is
    differentiated outside of it.
    """
    if torch.is_grad_enabled() and any(value.requires_grad for value in values):
        return True
    if torch.compiler.is_compiling():  # which traces backward derivatives only
        return False
    return any(map(transformed, values))


def transformed(value: Tensor) -> bool:
    """Whether a tensor is inside a transform that differentiates plain operations only.

    These are ``torch.func`` transforms, forward derivatives, and compilation.
    """
    if torch.compiler.is_compiling() or is_functorch_wrapped_tensor(value):
        return True
    return forward_ad.unpack_dual(value).tangent is not None


class TensorFunction(torch.autograd.Function):
    """A function that returns one tensor and defines its gradient."""

    @classmethod
    def call(cls, *args: object) -> Tensor:
        """``apply``, with types."""
        result: Tensor = cls.apply(*args)  # type: ignore[no-untyped-call]
        return result
