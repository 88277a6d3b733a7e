#![no_std]
//! Board-independent firmware of lipstream.
