//! Pulses as boards that make them want them.
use core::fmt::{self, Write};

use super::Pulse;

/// The target that ends a Maestro's pulses.
pub const MAESTRO_OFF: Pulse = 0;

/// Maestro's command "Set Target" in the compact protocol (Pololu, *Maestro Servo Controller User's Guide*): 0x84, channel, low seven and
/// high seven bits of the pulse in ¼ µs. A checked calibration has no output above 127 and no pulse of more than 14 bits.
pub fn maestro(output: u8, pulse: Pulse) -> [u8; 4] {
    [
        0x84,
        output & 0x7f,
        (pulse & 0x7f) as u8,
        (pulse >> 7 & 0x7f) as u8,
    ]
}

/// A line for an Arduino or a plotter: the pulses in µs with two decimals, commas between them, a line feed at the end.
///
/// # Errors
///
/// `to` takes no more.
pub fn csv(pulses: impl Iterator<Item = Pulse>, to: &mut impl Write) -> fmt::Result {
    for (k, pulse) in pulses.enumerate() {
        let comma = if k == 0 { "" } else { "," };
        write!(to, "{comma}{}.{:02}", pulse / 4, pulse % 4 * 25)?;
    }
    to.write_char('\n')
}

/// Prescaler of a PCA9685 for 50 pulses a second from its own 25 MHz (NXP, PCA9685 data sheet, register PRE_SCALE): 25 MHz/(4096·50 Hz) − 1, rounded.
pub const PCA9685_PRESCALE: u8 = 121;
/// Register of the prescaler; it is written while the chip sleeps.
pub const PCA9685_PRESCALE_REGISTER: u8 = 0xfe;
/// Register of the mode: [`PCA9685_SLEEP`] at first, then [`PCA9685_AWAKE`].
pub const PCA9685_MODE_REGISTER: u8 = 0x00;
/// Its oscillator stands; bit SLEEP alone.
pub const PCA9685_SLEEP: u8 = 0x10;
/// It runs, and registers increment by themselves; bit AI alone.
pub const PCA9685_AWAKE: u8 = 0x20;
/// Register, and what is written there, that ends the pulses of all outputs (ALL_LED_OFF_H, full OFF).
pub const PCA9685_ALL_OFF: [u8; 2] = [0xfd, 0x10];

/// What is written to a PCA9685 for one output: its first register, then on-time 0 and off-time in ticks of 4.88 µs. None above output 15, the
/// chip's last. The chip must increment its registers by itself (MODE1, bit AI).
pub fn pca9685(output: u8, pulse: Pulse) -> Option<[u8; 5]> {
    // A tick is (prescale + 1)/25 µs, and a µs is four units of a pulse: 25·2¹⁶ fits.
    let tick = 4 * (u32::from(PCA9685_PRESCALE) + 1);
    let off = ((u32::from(pulse) * 25 + tick / 2) / tick).min(4095) as u16;
    let [low, high] = off.to_le_bytes();
    (output < 16).then_some([0x06 + 4 * (output & 0x0f), 0, 0, low, high])
}
