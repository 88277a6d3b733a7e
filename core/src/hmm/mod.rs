//! The coupled hidden Markov model over phones and visemes (X&L sections 3 and 4), run live.
pub mod transition;
