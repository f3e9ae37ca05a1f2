"""The protocol of 3DMatch on folders of fragments: recall by the information matrix, scene by scene."""
