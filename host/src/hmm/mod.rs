//! The coupled HMM in floats: graphs of joint states, densities, forward-backward, EM, conversion.
//!
//! One graph type, one forward-backward: a system of X&L table 2 is a [`topology::Topology`], that is, which pairs of
//! an audio and a visual state exist and what the visual atoms are.
pub mod convert;
pub mod density;
pub mod em;
pub mod evaluator;
pub mod forward_backward;
pub mod graph;
pub mod network;
pub mod topology;
