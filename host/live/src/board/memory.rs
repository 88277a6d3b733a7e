//! Where a board's memory regions are, by the linker script `memory.x`: the one place that says so.
//!
//! The script chooses by symbols that the build defines. Of its language this knows what that file uses: assignments before `MEMORY`, and in
//! it `NAME : ORIGIN = …, LENGTH = …` with numbers (hexadecimal, or with K and M), names, `DEFINED(…)`, `+`, `-`, `||` and `? :`.
use std::collections::HashMap;

use thiserror::Error;

/// The script, as it was when this program was built.
const SCRIPT: &str = include_str!("../../shipped/memory.x");

/// A stretch of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// Its first address.
    pub start: u32,
    /// Its bytes.
    pub length: u32,
}

impl Region {
    /// Whether so many bytes from an address on lie in it.
    pub fn holds(&self, start: u32, length: u32) -> bool {
        let end = u64::from(start) + u64::from(length);
        start >= self.start && end <= u64::from(self.start) + u64::from(self.length)
    }
}

/// What this program cannot read in the script. It says that program and script are not of one version.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("memory.x, which came with this program, is not what it expects at {0:?}")]
pub struct ScriptError(String);

/// The regions by their names, for the board whose symbol is `board`.
///
/// # Errors
///
/// That the script has what is not known here.
pub fn regions(board: &str) -> Result<HashMap<String, Region>, ScriptError> {
    read(SCRIPT, board)
}

fn read(script: &str, board: &str) -> Result<HashMap<String, Region>, ScriptError> {
    let mut reader = Reader {
        words: words(script)?,
        at: 0,
        board,
        values: HashMap::new(),
    };
    while !reader.take("MEMORY") {
        let name = reader.next()?;
        reader.expect("=")?;
        let value = reader.expression()?;
        reader.expect(";")?;
        reader.values.insert(name, value);
    }
    reader.expect("{")?;
    let mut regions = HashMap::new();
    while !reader.take("}") {
        let name = reader.next()?;
        let [start, length] = [[":", "ORIGIN"], [",", "LENGTH"]].map(|before| {
            for word in before.into_iter().chain(["="]) {
                reader.expect(word)?;
            }
            let value = reader.expression()?;
            u32::try_from(value).map_err(|_| ScriptError(format!("{name} of {value:#x}")))
        });
        let (start, length) = (start?, length?);
        regions.insert(name, Region { start, length });
    }
    Ok(regions)
}

/// The words and signs of a script, without its comments.
fn words(script: &str) -> Result<Vec<String>, ScriptError> {
    let mut words = Vec::new();
    let mut rest = script.trim_start();
    while let Some(first) = rest.chars().next() {
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.';
        let length = if let Some(comment) = rest.strip_prefix("/*") {
            let end = comment
                .find("*/")
                .ok_or_else(|| ScriptError("a comment without end".to_owned()))?;
            rest = comment[end + 2..].trim_start();
            continue;
        } else if is_word(first) {
            rest.find(|c| !is_word(c)).unwrap_or(rest.len())
        } else if rest.starts_with("||") {
            2
        } else {
            first.len_utf8()
        };
        words.push(rest[..length].to_owned());
        rest = rest[length..].trim_start();
    }
    Ok(words)
}

struct Reader<'a> {
    words: Vec<String>,
    at: usize,
    /// The one symbol that is defined.
    board: &'a str,
    values: HashMap<String, i64>,
}

impl Reader<'_> {
    /// The next word, if it is this one.
    fn take(&mut self, word: &str) -> bool {
        let is_it = self.words.get(self.at).is_some_and(|next| next == word);
        self.at += usize::from(is_it);
        is_it
    }

    fn expect(&mut self, word: &str) -> Result<(), ScriptError> {
        match self.take(word) {
            true => Ok(()),
            false => {
                let found = self.next()?;
                Err(ScriptError(format!("{found}, where {word} should be")))
            }
        }
    }

    fn next(&mut self) -> Result<String, ScriptError> {
        let word = self.words.get(self.at).cloned();
        self.at += 1;
        word.ok_or_else(|| ScriptError("its end".to_owned()))
    }

    /// A condition, or what stands for one.
    fn expression(&mut self) -> Result<i64, ScriptError> {
        let value = self.any_of()?;
        if !self.take("?") {
            return Ok(value);
        }
        let yes = self.expression()?;
        self.expect(":")?;
        let no = self.expression()?;
        Ok(if value != 0 { yes } else { no })
    }

    fn any_of(&mut self) -> Result<i64, ScriptError> {
        let mut value = self.sum()?;
        while self.take("||") {
            let other = self.sum()?;
            value = i64::from(value != 0 || other != 0);
        }
        Ok(value)
    }

    fn sum(&mut self) -> Result<i64, ScriptError> {
        let mut value = self.operand()?;
        loop {
            if self.take("+") {
                value += self.operand()?;
            } else if self.take("-") {
                value -= self.operand()?;
            } else {
                return Ok(value);
            }
        }
    }

    fn operand(&mut self) -> Result<i64, ScriptError> {
        let word = self.next()?;
        if word == "(" {
            let value = self.expression()?;
            self.expect(")")?;
            return Ok(value);
        }
        if word == "DEFINED" {
            self.expect("(")?;
            let name = self.next()?;
            self.expect(")")?;
            return Ok(i64::from(name == self.board || self.values.contains_key(&name)));
        }
        let value = number(&word).or_else(|| self.values.get(&word).copied());
        value.ok_or(ScriptError(word))
    }
}

fn number(word: &str) -> Option<i64> {
    if let Some(digits) = word.strip_prefix("0x") {
        return u32::from_str_radix(digits, 16).ok().map(i64::from);
    }
    let (digits, unit) = match word.strip_suffix(['K', 'M']) {
        Some(digits) if word.ends_with('K') => (digits, 1 << 10),
        Some(digits) => (digits, 1 << 20),
        None => (word, 1),
    };
    digits.parse::<u32>().ok().map(|digits| i64::from(digits) * unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn expressions_are_read_as_the_linker_reads_them() {
        let script = "/* A = 1; */ A = DEFINED(X) || DEFINED(Y); B = A ? 1 : 0;
            MEMORY { R : ORIGIN = DEFINED(Y) ? 0x100 : B ? 2K + (1M - 1K) : 7, LENGTH = B - 1 + 3
                     S : ORIGIN = 1 + 2, LENGTH = 0x10 }
            SECTIONS { whatever }";
        let r = |board| read(script, board).unwrap()["R"];
        let region = |start, length| Region { start, length };
        assert_eq!(r("X"), region((1 << 20) + 1024, 3));
        assert_eq!(r("Y"), region(0x100, 3));
        assert_eq!(r("Z"), region(7, 2));
        assert_eq!(read(script, "Z").unwrap()["S"], region(3, 16));
        for bad in [
            "",
            "A = ;",
            "MEMORY { R : ORIGIN = Q, LENGTH = 1 }",
            "MEMORY { R : LENGTH = 1 }",
            "/* ",
            "MEMORY { R : ORIGIN = 0 - 1, LENGTH = 1 }",
            "MEMORY { R : ORIGIN = 0x1ffffffff, LENGTH = 1 }",
            "MEMORY { R : ORIGIN = (1, LENGTH = 1 }",
        ] {
            read(bad, "X").unwrap_err();
        }
    }

    #[test]
    fn a_region_holds_what_lies_in_it() {
        let region = Region {
            start: 0xffff_ff00,
            length: 0x100,
        };
        assert!(region.holds(0xffff_ff00, 0x100) && region.holds(0xffff_ffff, 1));
        assert!(!region.holds(0xffff_feff, 1) && !region.holds(0xffff_ff00, 0x101));
        assert!(!region.holds(0xffff_ffff, u32::MAX));
    }
}
