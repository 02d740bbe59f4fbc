"""Loaders, augmentation, the training loop, checkpoints."""
