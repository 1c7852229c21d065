//! The state machine against a model, under random operations.
