"""Training of what the paper fixes by hand: losses, augmentation, and weights learned on some scenes for others."""
