//! Cases that run both on the host and in QEMU (`tests/tests/shared_cases.rs`, `tests/tests/target.rs`).
//!
//! A case is a function without arguments that panics when it fails. To add one: write it in the module of its
//! stage and name it in [`cases!`]. `no_std`: data comes in with `include_bytes!`.
#![no_std]

pub mod fixed;
pub mod frontend;
pub mod random;
pub mod stream;
pub mod wire;

/// Calls the macro `$each` with every case, grouped by module.
#[macro_export]
macro_rules! cases {
    ($each:ident) => {
        $each! {
            fixed {
                products_of_halves,
            }
            frontend {
                energy,
                window,
                fft,
                magnitude,
                mel,
                log,
                dct,
                raw_observations,
                normalised_observations,
                normalised_observations_in_other_pieces,
            }
            stream {
                same_bytes_everywhere,
                feedback_gives_the_same_bytes_everywhere,
                a_recurrent_model_gives_the_same_bytes_everywhere,
                a_hierarchical_model_gives_the_same_bytes_everywhere,
                cuts_do_not_matter,
                a_reset_stream_is_a_new_one,
                a_sound_shorter_than_a_window_gives_nothing,
                extremes,
                the_vectors_move,
            }
            wire {
                reference_crc_check_value,
                encodes_as_specified,
                round_trip,
                short_buffers_are_refused,
                truncation,
                corruption,
                random_bytes,
                random_payloads,
                refusals_name_their_reason,
                unknown_messages_are_told_from_damage,
            }
        }
    };
}
