"""Descriptors whose votes pass smoothly from bin to bin, so that gradients flow through them."""
