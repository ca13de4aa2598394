//! Reports errors on the command line in one line each.

use crate::args::Arguments;
use clap::{
    Command, CommandFactory,
    error::{ContextKind, ContextValue},
};
use std::{ffi::OsStr, path::Path};
use trimip_core::Error;

/// Returns the error for arguments that clap rejected. `first` is the first argument.
pub fn error(mistake: &clap::Error, first: Option<&OsStr>) -> Error {
    if let Some(word) = first.and_then(OsStr::to_str).filter(|word| !is_verb(word) && is_missing(word)) {
        return no_verb(word);
    }
    // clap's text has a line that states the error, then paragraphs with tips and usage.
    let text = mistake.render().to_string();
    let text = text.split("\nUsage:").next().unwrap_or_default();
    let text = text.split("\nFor more").next().unwrap_or_default();
    let (tips, what): (Vec<&str>, Vec<&str>) = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty())
        .partition(|line| line.starts_with("tip: "));
    let what = what.join(" ");
    // clap suggests to pass an unknown option as a value; users seldom mean that.
    let tips = tips.into_iter().map(|tip| &tip["tip: ".len()..]).filter(|tip| !tip.starts_with("to pass "));
    let advice: Vec<&str> = tips.chain(["see trimip-cli --help"]).collect();
    Error::input("command line", what.trim_start_matches("error: "), advice.join("; "))
}

/// Returns the error for a word in the place of a verb or a folder that is neither.
pub fn no_verb(word: &str) -> Error {
    let advice = match similar_verb(word) {
        Some(verb) => format!("did you mean `trimip-cli {verb}`? `trimip-cli --help` shows all verbs"),
        None => "type `trimip-cli --help` for the verbs, or name a folder with photographs and their transforms.json".into(),
    };
    Error::input(word, "is neither a verb nor a folder", advice)
}

/// Returns true if `word` is neither an option nor the name of anything in the working directory.
fn is_missing(word: &str) -> bool {
    !word.starts_with('-') && !Path::new(word).exists()
}

fn is_verb(word: &str) -> bool {
    word == "help" || Arguments::command().get_subcommands().any(|verb| verb.get_name() == word)
}

/// Returns the verb that `word` resembles most; `None` if it resembles no verb.
fn similar_verb(word: &str) -> Option<String> {
    let verbs = Arguments::command();
    let verbs = Command::new("verbs").subcommands(verbs.get_subcommands().cloned());
    let mistake = verbs.try_get_matches_from(["verbs", word]).err()?;
    match mistake.get(ContextKind::SuggestedSubcommand)? {
        ContextValue::String(verb) => Some(verb.clone()),
        ContextValue::Strings(verbs) => verbs.last().cloned(),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    fn told(arguments: &[&str]) -> String {
        let mistake = Arguments::try_parse_from([&["x"], arguments].concat()).unwrap_err();
        error(&mistake, arguments.first().map(OsStr::new)).to_string()
    }

    #[test]
    fn a_verb_with_a_slip_is_told_with_the_one_that_was_meant() {
        for (word, verb) in [("trian", "train"), ("rendr", "render"), ("evla", "eval"), ("captur", "capture")]
        {
            assert_eq!(similar_verb(word).as_deref(), Some(verb), "{word}");
            let text = told(&[word, "capture"]);
            assert!(
                text.contains(&format!("{word}: is neither"))
                    && text.contains(&format!("`trimip-cli {verb}`"))
            );
        }
        assert_eq!(similar_verb("photographs"), None);
    }

    #[test]
    fn what_is_wrong_is_one_sentence_and_tips_are_advice() {
        let text = told(&["--bogus"]);
        assert!(
            text.contains("'--bogus'") && !text.contains("tip") && !text.contains("-- --bogus"),
            "{text}"
        );
        let text = told(&["--minute", "5"]);
        assert!(text.contains("found; a similar argument exists: '--minutes'"), "{text}");
        let text = told(&["render"]);
        assert!(!text.contains('\n') && text.contains("see trimip-cli --help"), "{text}");
    }
}
