//! The board's registers: the only unsafe code of this program.
use core::ptr::{read_volatile, write_volatile};

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;
use lipstream_firmware::Clock;
use lipstream_firmware::servo::lines::Sender;

/// UART0 and UART1, CMSDK APB UARTs.
const UART0: usize = 0x4000_4000;
const UART1: usize = 0x4000_5000;
/// FPGA I/O, counter at 25 MHz.
const COUNTER: usize = 0x4002_8018;

/// Byte offsets in the UART.
mod register {
    pub(super) const DATA: usize = 0;
    pub(super) const STATE: usize = 4;
    pub(super) const CONTROL: usize = 8;
    /// Writing a bit clears that interrupt.
    pub(super) const INTERRUPTS: usize = 0xc;
    pub(super) const BAUD_DIVISOR: usize = 0x10;
}

/// Bits of STATE: the one-byte buffers are full.
const SEND_FULL: u32 = 1;
const RECEIVE_FULL: u32 = 2;
/// Bits of CONTROL: both directions, and an interrupt for every byte that comes.
const ENABLE: u32 = 0b1011;
const SENDS: u32 = 0b0001;
/// Bit of INTERRUPTS.
const RECEIVED: u32 = 2;
/// 16 is the smallest divisor that works; QEMU takes no time for a byte whatever it is.
const DIVISOR: u32 = 16;

fn read(address: usize) -> u32 {
    // SAFETY: only called with addresses of 32-bit registers of this board, see the constants.
    unsafe { read_volatile(address as *const u32) }
}

fn write(address: usize, value: u32) {
    // SAFETY: as in `read`; none of these registers changes memory.
    unsafe { write_volatile(address as *mut u32, value) }
}

/// Number of UART0's interrupt for a byte that came.
#[derive(Clone, Copy)]
struct Uart0Receive;

// SAFETY: the board's interrupt 0.
unsafe impl InterruptNumber for Uart0Receive {
    fn number(self) -> u16 {
        0
    }
}

/// One direction of a UART.
pub(crate) struct Uart(usize);

/// UART0 ready to send and to receive.
pub(crate) fn uart0() -> (Uart, Uart) {
    // The interrupt only ends the processor's sleep; no handler ever runs.
    cortex_m::interrupt::disable();
    // SAFETY: interrupts are disabled for good.
    unsafe { NVIC::unmask(Uart0Receive) };
    write(UART0 + register::BAUD_DIVISOR, DIVISOR);
    write(UART0 + register::CONTROL, ENABLE);
    (Uart(UART0), Uart(UART0))
}

/// UART1 ready to send.
pub(crate) fn uart1() -> Uart {
    write(UART1 + register::BAUD_DIVISOR, DIVISOR);
    write(UART1 + register::CONTROL, ENABLE & SENDS);
    Uart(UART1)
}

impl Sender for Uart {
    fn put(&mut self, byte: u8) {
        Self::put(self, byte);
    }
}

impl Uart {
    /// Sends a byte, waiting for room.
    pub(crate) fn put(&mut self, byte: u8) {
        while read(self.0 + register::STATE) & SEND_FULL != 0 {}
        write(self.0 + register::DATA, byte.into());
    }

    /// Waits for a byte, asleep: a processor that asks on and on leaves QEMU little time to bring it.
    pub(crate) fn get(&self) -> u8 {
        while read(self.0 + register::STATE) & RECEIVE_FULL == 0 {
            // A byte that came since the question has left its interrupt pending: no sleep then.
            cortex_m::asm::wfi();
            write(self.0 + register::INTERRUPTS, RECEIVED);
            NVIC::unpend(Uart0Receive);
        }
        read(self.0 + register::DATA) as u8
    }
}

/// The board's counter, or one that stands still.
pub(crate) enum Counter {
    Running,
    Still,
}

impl Clock for Counter {
    fn ticks(&self) -> u32 {
        match self {
            Self::Running => read(COUNTER),
            Self::Still => 0,
        }
    }
}
