//! Tests what is computed: physics, photographs that become profiles, and media that are found again.

mod capture;
mod measure;
mod physics;
