//! UF2 files (<https://github.com/microsoft/uf2>): what boot loaders take that show themselves as a drive.
//!
//! ```text
//! block of 512 bytes   "UF2\n", 0x9e5d5157, flags, address, bytes of data, number of the block, blocks in all, family, data [476], 0x0ab16f30
//! ```
//!
//! All numbers are u32, low byte first. A block carries a page of 256 bytes, which is what RP2040's ROM asks for. It erases a sector with the first
//! page that comes for it and may leave sectors wrong of which some pages never come (erratum RP2040-E14): every sector that is touched is
//! written whole.
use std::collections::BTreeMap;

const BLOCK: usize = 512;
const PAGE: u32 = 256;
/// Bytes that flash chips erase at once, those of RP2040's boards and nRF52840 alike.
const SECTOR: u32 = 4096;
/// What stays of a page that nothing is written to.
const ERASED: u8 = 0xff;
/// The first number after the letters.
const SECOND_MAGIC: u32 = 0x9e5d_5157;
const LAST_MAGIC: u32 = 0x0ab1_6f30;
/// The field after the number of blocks names a family of processors.
const HAS_FAMILY: u32 = 0x2000;
/// Bytes before the data.
const HEADER: usize = 32;

/// A file that writes these pieces, each at its address, to a processor of this family. Where two overlap the later one is written.
pub fn write(pieces: &[(u32, &[u8])], family: u32) -> Vec<u8> {
    let mut pages: BTreeMap<u32, [u8; PAGE as usize]> = BTreeMap::new();
    for (start, bytes) in pieces {
        for (address, byte) in (*start..).zip(*bytes) {
            let sector = address - address % SECTOR;
            if !pages.contains_key(&sector) {
                let whole = (sector..sector + SECTOR).step_by(PAGE as usize);
                pages.extend(whole.map(|page| (page, [ERASED; PAGE as usize])));
            }
            if let Some(page) = pages.get_mut(&(address - address % PAGE)) {
                page[(address % PAGE) as usize] = *byte;
            }
        }
    }
    let count = pages.len() as u32;
    let mut file = Vec::with_capacity(pages.len() * BLOCK);
    for (number, (address, page)) in (0..).zip(pages) {
        let start = file.len();
        file.extend(b"UF2\n");
        for field in [SECOND_MAGIC, HAS_FAMILY, address, PAGE, number, count, family] {
            file.extend(field.to_le_bytes());
        }
        debug_assert_eq!(file.len() - start, HEADER);
        file.extend(page);
        file.resize(start + BLOCK - 4, 0);
        file.extend(LAST_MAGIC.to_le_bytes());
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a boot loader does with a file, by the specification alone.
    fn flash(file: &[u8], family: u32) -> BTreeMap<u32, u8> {
        let mut flash = BTreeMap::new();
        let blocks = file.len() / 512;
        assert_eq!(file.len() % 512, 0);
        for (n, block) in file.chunks(512).enumerate() {
            let field = |at: usize| u32::from_le_bytes(block[at..at + 4].try_into().unwrap());
            assert_eq!(&block[..4], b"UF2\n");
            assert_eq!((field(4), field(508)), (0x9e5d_5157, 0x0ab1_6f30));
            assert_eq!((field(8), field(16), field(28)), (0x2000, 256, family));
            assert_eq!((field(20), field(24)), (n as u32, blocks as u32));
            assert_eq!(field(12) % 256, 0);
            for (address, byte) in (field(12)..).zip(&block[32..288]) {
                assert_eq!(flash.insert(address, *byte), None, "written once");
            }
            assert!(block[288..508].iter().all(|byte| *byte == 0));
        }
        flash
    }

    #[test]
    fn every_byte_lands_where_it_belongs_in_whole_sectors() {
        let program: Vec<u8> = (0..5000_u32).map(|i| (i * 7) as u8).collect();
        let model = [1, 2, 3];
        let written = flash(
            &write(&[(0x1000_0100, &program), (0x1010_0000, &model)], 0xe48b_ff56),
            0xe48b_ff56,
        );
        // Two sectors of the program, one of the model.
        assert_eq!(written.len(), 3 * 4096);
        assert!(
            written
                .keys()
                .all(|at| (0x1000_0000..0x1000_2000).contains(at) || (0x1010_0000..0x1010_1000).contains(at))
        );
        for (address, byte) in &written {
            let want = match address {
                0x1000_0100..0x1000_1488 => program[(address - 0x1000_0100) as usize],
                0x1010_0000..0x1010_0003 => model[(address - 0x1010_0000) as usize],
                _ => 0xff,
            };
            assert_eq!(*byte, want, "{address:x}");
        }
    }

    #[test]
    fn nothing_gives_an_empty_file() {
        assert!(write(&[], 1).is_empty());
        assert!(write(&[(0x1000, &[])], 1).is_empty());
    }
}
