//! Whether a robot description is what its author meant: geometry, base parameters, identities.
