//! A whole face: the drawn mouth cloned onto a recording of somebody (X&L section 6.2).
//!
//! ```text
//! recording ─► Footage: pictures, and where mouth and jaw lie in each (found by `lipstream-make`)
//!                 │
//!                 ├─► Course      which recorded picture is shown when, for any length of time
//!                 ├─► Mouths      the recording's own mouths: how they look at its resolution, their fine detail
//!                 └─► jaws        lower faces, of which one is chosen for each picture
//! parameters of a film ─► FaceScene ─┐ which moment, detail and lower face
//! parameters as they come ► LiveFace ┴─► Portrait: background ◄─clone─ lower face ◄─clone─ mouth
//! ```
mod course;
mod footage;
mod jaw;
mod layer;
mod live;
mod membrane;
mod mouths;
pub mod person;
mod portrait;
mod raster;
mod scene;

pub use course::{Course, Moment};
pub use footage::{Edge, Footage, Jaw, Pictures, Place};
pub use jaw::JawBy;
pub use layer::Region;
pub use live::LiveFace;
pub use membrane::Membrane;
pub use mouths::{Fit, Mouths, Whose};
pub use raster::{Bytes, Floats, Raster};
pub use scene::{FaceScene, FaceSettings, Wanted};

#[cfg(test)]
mod tests;
