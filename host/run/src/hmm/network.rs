//! Networks of phones: the loop over all phones that conversion runs on, and the left-right network of an utterance
//! that training runs on.
use crate::phones::Phone;

/// A word with the ways in which it may be said.
pub trait Pronounced {
    /// Pronunciations as names of phones, the most usual first.
    fn pronunciations(&self) -> &[Vec<String>];
}

/// A directed graph of phones. Nodes hold indices into the model's phone list.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PhoneNetwork {
    /// Phone of each node, as index into the model's list.
    pub nodes: Vec<usize>,
    /// Word of each node, as index into the transcript; `None` for pauses.
    pub words: Vec<Option<usize>>,
    /// Successors of each node with the natural log of their probability.
    pub successors: Vec<Vec<(usize, f32)>>,
    /// Where an utterance may begin, with log probability.
    pub entries: Vec<(usize, f32)>,
    /// Where it may end; empty: anywhere, in the middle of a phone too.
    pub exits: Vec<usize>,
}

impl PhoneNetwork {
    /// All phones, each followed by each, with a bigram.
    pub fn phone_loop(initial: &[f32], bigram: &ndarray::Array2<f32>) -> Self {
        let n = initial.len();
        Self {
            nodes: (0..n).collect(),
            words: vec![None; n],
            successors: (0..n)
                .map(|p| (0..n).map(|q| (q, bigram[[p, q]])).collect())
                .collect(),
            entries: initial.iter().copied().enumerate().collect(),
            exits: Vec::new(),
        }
    }

    /// One phone after the other.
    pub fn chain(phones: &[usize]) -> Self {
        let n = phones.len();
        Self {
            nodes: phones.to_vec(),
            words: vec![None; n],
            successors: (0..n)
                .map(|i| if i + 1 < n { vec![(i + 1, 0.0)] } else { Vec::new() })
                .collect(),
            entries: if n > 0 { vec![(0, 0.0)] } else { Vec::new() },
            exits: if n > 0 { vec![n - 1] } else { Vec::new() },
        }
    }

    /// A transcript: every pronunciation of every word, an optional short pause between words, silence at both ends.
    ///
    /// `index` gives the model's index of a phone, or `None` for a phone that the model lacks: a pronunciation with
    /// such a phone is left out. Returns `None` if a word has no pronunciation left.
    pub fn transcript<W: Pronounced>(words: &[W], index: &dyn Fn(Phone) -> Option<usize>) -> Option<Self> {
        let (sil, sp) = (index(Phone::SIL)?, index(Phone::SP));
        let mut net = PhoneNetwork::default();
        let first = net.node(sil, None);
        net.entries.push((first, 0.0));
        // Ends of what has been built, to be joined to the next word's beginnings.
        let mut open = vec![first];
        let mut said = 0;
        for (number, word) in words.iter().enumerate() {
            let spoken: Vec<Vec<usize>> = word
                .pronunciations()
                .iter()
                .filter_map(|p| {
                    p.iter()
                        .map(|name| Phone::from_name(name).and_then(index))
                        .collect()
                })
                .collect();
            if spoken.is_empty() {
                return None;
            }
            if spoken
                .iter()
                .all(|p| p.iter().all(|&q| q == sil || Some(q) == sp))
            {
                // A silence written into the transcript: at the ends it is there already, inside it is the pause.
                continue;
            }
            if said > 0
                && let Some(sp) = sp
            {
                let pause = net.node(sp, None);
                for &end in &open {
                    net.successors[end].push((pause, 0.0));
                }
                open.push(pause);
            }
            said += 1;
            let mut ends = Vec::new();
            for phones in &spoken {
                let mut last: Option<usize> = None;
                for &phone in phones {
                    let node = net.node(phone, Some(number));
                    match last {
                        Some(before) => net.successors[before].push((node, 0.0)),
                        None => open.iter().for_each(|&end| net.successors[end].push((node, 0.0))),
                    }
                    last = Some(node);
                }
                ends.extend(last);
            }
            open = ends;
        }
        let end = net.node(sil, None);
        for &node in &open {
            net.successors[node].push((end, 0.0));
        }
        net.exits.push(end);
        net.share_probability();
        Some(net)
    }

    /// A transcript's network in which a pause between words may be `silence` too, as between sentences.
    pub fn with_long_pauses(mut self, silence: usize) -> Self {
        let count = self.nodes.len();
        let at_an_end = |node: usize| self.exits.contains(&node) || self.entries.iter().any(|e| e.0 == node);
        let pauses: Vec<usize> = (0..count)
            .filter(|&node| self.words[node].is_none() && !at_an_end(node))
            .collect();
        for pause in pauses {
            let twin = self.node(silence, None);
            self.successors[twin] = self.successors[pause].clone();
            for next in &mut self.successors[..count] {
                if next.iter().any(|(node, _)| *node == pause) {
                    next.push((twin, 0.0));
                }
            }
        }
        self.share_probability();
        self
    }

    /// A transcript's network in which any of the `first` words at the beginning, and any of the `last` at the end, may be left out.
    pub fn with_open_ends(mut self, first: usize, last: usize) -> Self {
        let (Some(&(begin, _)), Some(&end)) = (self.entries.first(), self.exits.first()) else {
            return self;
        };
        let count = self.words.iter().flatten().max().map_or(0, |last| last + 1);
        let mut begins = vec![true; self.nodes.len()];
        let mut ends = vec![true; self.nodes.len()];
        for (node, next) in self.successors.iter().enumerate() {
            for &(next, _) in next {
                if self.words[node].is_some() && self.words[node] == self.words[next] {
                    (begins[next], ends[node]) = (false, false);
                }
            }
        }
        for node in 0..self.nodes.len() {
            let Some(word) = self.words[node] else { continue };
            let arc = |from: &mut Vec<(usize, f32)>, to: usize| {
                if !from.iter().any(|(next, _)| *next == to) {
                    from.push((to, 0.0));
                }
            };
            if begins[node] && word <= first {
                arc(&mut self.successors[begin], node);
            }
            if ends[node] && word + 1 + last >= count {
                arc(&mut self.successors[node], end);
            }
        }
        self.share_probability();
        self
    }

    /// The phones of a left-right network in which the first of several ways stands for all: labels as they are, of a transcript the usual
    /// pronunciations.
    pub fn usual(&self) -> Vec<usize> {
        let mut said = Vec::new();
        let mut node = self.entries.first().map(|e| e.0);
        while let Some(at) = node {
            said.push(self.nodes[at]);
            node = self.successors[at].first().map(|s| s.0);
        }
        said
    }

    fn node(&mut self, phone: usize, word: Option<usize>) -> usize {
        self.nodes.push(phone);
        self.words.push(word);
        self.successors.push(Vec::new());
        self.nodes.len() - 1
    }

    /// Successors of a node are equally likely.
    fn share_probability(&mut self) {
        for next in &mut self.successors {
            let share = -(next.len().max(1) as f32).ln();
            next.iter_mut().for_each(|(_, weight)| *weight = share);
        }
    }

    /// Fewest frames that an utterance through this network takes, at `per_phone` frames a phone.
    pub fn shortest(&self, per_phone: usize) -> usize {
        let mut best = vec![usize::MAX; self.nodes.len()];
        let mut queue: std::collections::VecDeque<usize> = self.entries.iter().map(|e| e.0).collect();
        queue.iter().for_each(|&n| best[n] = 1);
        while let Some(node) = queue.pop_front() {
            for &(next, _) in &self.successors[node] {
                if best[node] + 1 < best[next] {
                    best[next] = best[node] + 1;
                    queue.push_back(next);
                }
            }
        }
        self.exits
            .iter()
            .map(|&n| best[n])
            .min()
            .unwrap_or(1)
            .saturating_mul(per_phone)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Word(Vec<Vec<String>>);

    impl Pronounced for Word {
        fn pronunciations(&self) -> &[Vec<String>] {
            &self.0
        }
    }

    fn word(pronunciations: &[&[&str]]) -> Word {
        let names = |p: &&[&str]| p.iter().map(|s| (*s).to_owned()).collect();
        Word(pronunciations.iter().map(names).collect())
    }

    fn all(phone: Phone) -> Option<usize> {
        Some(usize::from(phone.0))
    }

    #[test]
    fn alternatives_and_pauses_branch() {
        let words = [word(&[&["ax"], &["ey"]]), word(&[&["b", "iy"]])];
        let net = PhoneNetwork::transcript(&words, &all).unwrap();
        // sil, ax, ey, sp, b, iy, sil
        assert_eq!(net.nodes.len(), 7);
        let words = [None, Some(0), Some(0), None, Some(1), Some(1), None];
        assert_eq!(net.words, words);
        let begin = net.entries[0].0;
        assert_eq!(net.successors[begin].len(), 2);
        assert!((net.successors[begin][0].1 - 0.5f32.ln()).abs() < 1e-6);
        assert_eq!(net.shortest(1), 5);
    }

    #[test]
    fn a_pause_may_be_long() {
        let words = [word(&[&["b"]]), word(&[&["d"], &["s"]])];
        let all = |p: Phone| Some(usize::from(p.0));
        let short = PhoneNetwork::transcript(&words, &all).unwrap();
        let long = short.clone().with_long_pauses(0);
        assert_eq!(long.nodes.len(), short.nodes.len() + 1);
        let twin = long.nodes.len() - 1;
        assert_eq!((long.nodes[twin], long.words[twin]), (0, None));
        let b = (0..twin).find(|n| long.words[*n] == Some(0)).unwrap();
        let after_b: Vec<usize> = long.successors[b].iter().map(|(n, _)| long.nodes[*n]).collect();
        let phone = |name: &str| usize::from(Phone::from_name(name).unwrap().0);
        assert_eq!(after_b, [phone("sp"), phone("d"), phone("s"), phone("sil")]);
        assert_eq!(long.successors[twin].len(), 2);
        let sum: f32 = long.successors[b].iter().map(|(_, w)| w.exp()).sum();
        assert!((sum - 1.0).abs() < 1e-5);
    }

    #[test]
    fn words_at_open_ends_may_be_left_out() {
        let words = [word(&[&["b"]]), word(&[&["d", "iy"], &["d"]]), word(&[&["s"]])];
        let all = |p: Phone| Some(usize::from(p.0));
        let closed = PhoneNetwork::transcript(&words, &all).unwrap();
        let open = closed.clone().with_open_ends(1, 1);
        let after = |net: &PhoneNetwork, node: usize| -> Vec<Option<usize>> {
            net.successors[node].iter().map(|(n, _)| net.words[*n]).collect()
        };
        assert_eq!(after(&closed, closed.entries[0].0), [Some(0)]);
        assert_eq!(after(&open, open.entries[0].0), [Some(0), Some(1), Some(1)]);
        let end = open.exits[0];
        let before = |net: &PhoneNetwork| -> Vec<Option<usize>> {
            let leads = |n: &usize| net.successors[*n].iter().any(|(next, _)| *next == end);
            (0..net.nodes.len()).filter(leads).map(|n| net.words[n]).collect()
        };
        assert_eq!(before(&closed), [Some(2)]);
        assert_eq!(before(&open), [Some(1), Some(1), Some(2)]);
        assert_eq!(closed.clone().with_open_ends(0, 0), closed);
    }

    #[test]
    fn a_word_that_cannot_be_said_is_reported() {
        let words = [word(&[&["k", "s"]])];
        let without_k = |p: Phone| (p.name() != "k").then_some(usize::from(p.0));
        assert_eq!(PhoneNetwork::transcript(&words, &without_k), None);
    }
}
