#![no_std]
//! Cases shared by the host run and the QEMU run.
