//! The kinds of models, a folder each: what their files hold and how they speak in floats.
pub mod hierarchical;
pub mod likelihood;
pub mod recurrent;
