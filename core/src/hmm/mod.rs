//! What kinds of model share that follow a coupled hidden Markov model over phones and visemes live (X&L = Xie & Liu 2007, *A
//! coupled HMM approach to video-realistic speech animation*, section 3): one stage a file.
//!
//! [`search`] runs a frame: [`token`] moves probability along [`transition`]'s arcs, the kind says how well each state fits, and
//! [`beam`] keeps the best joint states. [`gates`] chooses the states that take part in a frame. [`tables`] holds the phones.
pub mod beam;
pub mod gates;
pub mod search;
pub mod tables;
pub mod token;
pub mod transition;

pub use search::Search;
pub use tables::HmmTables;
