//! Accuracy and refusals of the evaluation of photographs, with simulated photographs whose true profile is known.

mod contents;
mod faults;
mod figures;
mod further_shots;
mod patches;
mod real_sensor;
mod refusals;
mod stage;
