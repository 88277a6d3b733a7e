//! The wire format.

pub fn crc_check_value() {
    assert_eq!(1, 1);
}
