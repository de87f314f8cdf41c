//! Empty: the integration tests in `tests/` share only this package's dependencies.
