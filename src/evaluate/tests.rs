//! Honest bounds of the program's detectors on a small fleet.
