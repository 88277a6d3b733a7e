//! The coupled hidden Markov model over phones and visemes (X&L sections 3 and 4), run live: one stage a file.
//!
//! Per frame [`follower`] runs: [`density`] says how well the sound fits each active audio state, [`token`] moves probability along
//! [`transition`]'s arcs, [`beam`] keeps the best joint states, [`lag`] smooths over the last frames. Then
//! [`local_linear`] turns the visual states' occupancies and the context into mouth parameters, or [`feedback`] the occupancies
//! and the mouth itself. [`converter`] runs them in order.
pub mod beam;
pub mod converter;
pub mod density;
pub mod feedback;
pub mod follower;
pub mod gates;
pub mod lag;
pub mod local_linear;
pub mod token;
pub mod transition;
