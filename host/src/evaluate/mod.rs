//! Measuring models on a feature folder.
pub mod metrics;
