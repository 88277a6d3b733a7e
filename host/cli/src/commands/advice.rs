//! What to do about an error, in words of the command line: the libraries know nothing of its flags.
use std::error::Error as StdError;

use anyhow::anyhow;
use lipstream::engine::SettingError;
use lipstream::export::ExportError;

/// Adds to an error which flag would help, where one would.
pub(super) fn with_flags(error: anyhow::Error) -> anyhow::Error {
    match error.chain().find_map(advice) {
        Some(advice) => anyhow!("{error:#}{advice}"),
        None => error,
    }
}

/// Errors that stand for another are asked for what is in them: their own chain leaves it out.
fn advice(error: &(dyn StdError + 'static)) -> Option<&'static str> {
    if let Some(error) = error.downcast_ref::<lipstream_make::Error>() {
        return match error {
            lipstream_make::Error::Unspoken { .. } => Some(" (--dictionary FILE)"),
            lipstream_make::Error::Other(inner) => advice(inner.as_ref()),
            _ => None,
        };
    }
    if let Some(error) = error.downcast_ref::<lipstream::Error>() {
        return match error {
            lipstream::Error::Kind { .. } => Some(": train one with --train mge"),
            lipstream::Error::NoFloats(_) => Some(": name that model, or leave --engine float out"),
            lipstream::Error::Setting(error) => of_setting(error),
            lipstream::Error::Export(error) => of_export(error),
            lipstream::Error::Other(inner) => advice(inner.as_ref()),
            _ => None,
        };
    }
    if let Some(error) = error.downcast_ref::<SettingError>() {
        return of_setting(error);
    }
    of_export(error.downcast_ref::<ExportError>()?)
}

fn of_setting(error: &SettingError) -> Option<&'static str> {
    Some(match error {
        SettingError::Settle => ": leave --no-settling out",
        SettingError::Feedback => {
            ": give the model that they were exported from, or export it with --visual-densities"
        }
        SettingError::FloatBeam => ": leave --beam out",
        SettingError::FloatProfile => ": give --lag instead of --profile",
        SettingError::FloatRecurrent => ": leave --beam, --lag and --feedback out",
        _ => return None,
    })
}

fn of_export(error: &ExportError) -> Option<&'static str> {
    match error {
        ExportError::System(_) => Some(": train one with `--system local-linear`"),
        ExportError::MemoryFeedback => Some(": train with `--feedback output`"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context as _;

    #[test]
    fn flags_are_named_wherever_the_error_is_hidden() {
        let inside = |error: anyhow::Error| format!("{:#}", with_flags(error.context("doing this")));
        let export = || ExportError::MemoryFeedback;
        assert!(inside(export().into()).ends_with("not the memory: train with `--feedback output`"));
        assert!(inside(lipstream::Error::from(export()).into()).ends_with("`--feedback output`"));
        let make = lipstream_make::Error::other(lipstream::Error::from(export()));
        assert!(inside(make.into()).ends_with("`--feedback output`"));
        let unspoken = lipstream_make::Error::Unspoken {
            word: "§".to_owned()
        };
        let text = Err::<(), _>(unspoken).context("the text").unwrap_err();
        assert!(inside(text).ends_with("of your own (--dictionary FILE)"));
        assert_eq!(inside(anyhow!("plain")), "doing this: plain");
    }
}
