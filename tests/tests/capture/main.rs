//! From photographs to profiles: figures of the stage, with photographs whose truth is known.

mod faults;
mod figures;
mod patches;
mod real_sensor;
mod refusals;
mod stage;
