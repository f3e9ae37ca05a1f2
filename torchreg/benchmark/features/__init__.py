"""Anyone's features on pairs of known truth, by the protocol of 3DMatch and Color3DMatch, beside FPFH."""
