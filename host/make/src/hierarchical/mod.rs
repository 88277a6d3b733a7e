//! What a hierarchical model (COS, `docs/hierarchical.md`) is made of. So far: shapes laid onto each other.
pub mod procrustes;
