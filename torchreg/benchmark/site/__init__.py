"""Sites of many scans, real and simulated: which poses are right, which are wrong, how far off, how long it takes."""
