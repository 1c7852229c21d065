//! What is refused, and that what is good is not.
