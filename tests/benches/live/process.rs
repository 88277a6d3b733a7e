//! What processes take, from Linux's `/proc`.
use std::collections::HashMap;
use std::path::Path;

/// Processor time and memory.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Usage {
    /// Seconds of one processor, in all threads.
    pub(crate) seconds: f64,
    /// Memory of its own and its share of what is shared, KiB.
    pub(crate) kib: u64,
}

impl std::ops::AddAssign for Usage {
    fn add_assign(&mut self, other: Usage) {
        self.seconds += other.seconds;
        self.kib += other.kib;
    }
}

/// This process, the QEMU that it started, and a browser: the process of the page, and all others.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Family {
    pub(crate) host: Usage,
    pub(crate) qemu: Usage,
    pub(crate) page: Usage,
    pub(crate) rest: Usage,
}

impl Family {
    pub(crate) fn of(browser: u32) -> Self {
        let mut all = HashMap::new();
        for entry in std::fs::read_dir("/proc").unwrap().flatten() {
            let Some(pid) = entry
                .file_name()
                .to_str()
                .and_then(|name| name.parse::<u32>().ok())
            else {
                continue;
            };
            if let Some(process) = Process::read(&entry.path()) {
                all.insert(pid, process);
            }
        }
        let own = std::process::id();
        let mut family = Self::default();
        for (pid, process) in &all {
            let descends = |from: u32| {
                let mut at = *pid;
                while at != from && at > 1 {
                    at = all.get(&at).map_or(0, |p| p.parent);
                }
                at == from
            };
            if *pid == own {
                family.host = process.usage;
            } else if descends(browser) {
                match process.words.contains("--type=renderer") {
                    true => family.page += process.usage,
                    false => family.rest += process.usage,
                }
            } else if descends(own) && process.words.contains("qemu") {
                family.qemu += process.usage;
            }
        }
        family
    }
}

struct Process {
    parent: u32,
    words: String,
    usage: Usage,
}

impl Process {
    fn read(folder: &Path) -> Option<Self> {
        let text = |name: &str| {
            std::fs::read(folder.join(name))
                .map(|b| String::from_utf8_lossy(&b).into_owned())
                .ok()
        };
        let stat = text("stat")?;
        // The name may hold anything; fields are counted from behind it.
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        let ticks: f64 = fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
        let memory = text("smaps_rollup").unwrap_or_default();
        let pss = memory.lines().find_map(|line| line.strip_prefix("Pss:"));
        let kib = pss.and_then(|rest| rest.split_whitespace().next()?.parse().ok());
        Some(Self {
            parent: fields.get(1)?.parse().ok()?,
            words: text("cmdline")?.replace('\0', " "),
            usage: Usage {
                seconds: ticks / 100.0,
                kib: kib.unwrap_or(0),
            },
        })
    }
}
