//! Logs over RTT, for a debug probe (feature `defmt`): how the program began, and how it ends. What the application says between is logged where it
//! says it. Without a probe they fill a buffer in RAM, and nobody waits for anything.
use core::fmt;

use defmt::Display2Format;
use defmt_rtt as _;
use lipstream_core::model::Head;

use super::visible;

defmt::timestamp!("{=u32:us}", visible::microseconds());

/// The program has begun, by its board's word for why, with this model.
pub(crate) fn started(head: &Head) {
    defmt::info!(
        "started by {=str}, model {=u32:#x} of {=usize} parameters",
        visible::why_started(),
        head.id(),
        head.parameter_scales().count()
    );
}

/// The program is over.
pub(crate) fn ended(words: &fmt::Arguments) {
    visible::about_to_end();
    defmt::error!("{}", Display2Format(words));
}
