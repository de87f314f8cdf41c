//! What the tests have in common: nothing but their dependencies.
