"""Methods of the field on real pairs: recall by both definitions, matches, errors and time, with intervals."""
