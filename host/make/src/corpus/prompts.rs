//! What to read aloud before a camera, so that every phone is seen often enough in about two minutes.

/// Sentences for about five seconds each, ours. A test counts their phones.
pub const PROMPTS: [&str; 24] = [
    "The boy with the brown jacket bought five cheap maps of the harbour.",
    "She usually measures the beige carpet before she cuts it.",
    "Please put both of these blue books back on the top shelf.",
    "Our judge enjoys a large orange and some fudge in the garage.",
    "Whoever found the silver ring should bring it here on Thursday.",
    "A thin cloud of smoke is moving over the northern mountains.",
    "They thought that the weather would be rather smooth this month.",
    "Few people knew why the huge ship was so far from the shore.",
    "My father calmly watched the farm cars go past the pond.",
    "Look, the good cook could hardly push the wooden bucket.",
    "The nurse heard early birds sing in the dirty church yard.",
    "Nine young men were hanging a long banner on the wall.",
    "Joyce pointed out an oily coin to the noisy boys.",
    "How about a round of loud music in the old town house now?",
    "Take eight plates away and wait a day for the late train.",
    "I tried to find nine kind guides who like to climb ice at night.",
    "We agree that each green leaf needs a week of heat.",
    "Big fish swim in still rivers until winter brings thin ice.",
    "Several men rested their heads on red benches by the edge.",
    "That black cat sat at the back and had a snack.",
    "Mother must love some sudden fun in the hot summer sun.",
    "Go home slowly, and hold the yellow rope close to your coat.",
    "Who chose the cool blue shoes for you and your group of two?",
    "Watch the vision of a vast, azure valley, then close your eyes.",
];

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::corpus::labels::SpokenWord;
    use crate::corpus::pronounce::{Origin, Pronouncer};
    use lipstream::phones::Phone;

    /// Every phone that words are made of comes at least five times, the rarest one at least three, and no word is unknown.
    #[test]
    fn every_phone_is_read_often_enough() {
        let pronouncer = Pronouncer::new(None).unwrap();
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        for word in PROMPTS.iter().flat_map(|sentence| sentence.split_whitespace()) {
            let text: String = word
                .chars()
                .filter(|c| c.is_alphanumeric() || *c == '\'')
                .collect();
            let spoken = SpokenWord {
                text: text.to_lowercase(),
                time: None,
                letter_name: false,
            };
            let (said, origin) = pronouncer.word(&spoken).unwrap();
            assert!(!matches!(origin, Origin::Letters), "{text} is in no dictionary");
            for phone in &said[0] {
                *counts.entry(phone.name()).or_default() += 1;
            }
        }
        println!("{counts:?}");
        // Silences, and reduced sounds that no dictionary writes.
        let never = ["sil", "sp", "axr", "ix", "el", "en", "em", "ax"];
        for phone in Phone::all().map(Phone::name).filter(|name| !never.contains(name)) {
            let least = if phone == "zh" { 3 } else { 5 };
            assert!(
                counts.get(phone).copied().unwrap_or(0) >= least,
                "{phone}: {:?}",
                counts.get(phone)
            );
        }
    }
}
