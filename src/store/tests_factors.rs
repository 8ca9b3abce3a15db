//! Factors, unit parameters and cross-verification in the database.
