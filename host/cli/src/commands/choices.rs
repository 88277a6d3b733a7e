//! Words on the command line that stand for a library's choices: the libraries know nothing of a command line.

/// An enum of words that the arguments take, each of which stands for the library's variant of the same name.
macro_rules! choice {
    ($(#[$about:meta])* $name:ident for $library:path { $($(#[$help:meta])* $variant:ident),+ $(,)? }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
        pub(crate) enum $name {
            $($(#[$help])* $variant),+
        }

        impl From<$name> for $library {
            fn from(word: $name) -> Self {
                type Library = $library;
                match word {
                    $($name::$variant => Library::$variant),+
                }
            }
        }

        impl From<$library> for $name {
            fn from(choice: $library) -> Self {
                type Library = $library;
                match choice {
                    $(Library::$variant => Self::$variant),+
                }
            }
        }
    };
}

choice! {
    /// The arithmetic that runs a model.
    Engine for lipstream::engine::Kind {
        /// The device's own code and tables
        Fixed,
        /// Floats, no beam
        Float,
    }
}

choice! {
    /// How the mouth is found from the states.
    MouthBy for lipstream::hmm::system::Speech {
        /// EM from the components' means, as in the paper: the likeliest mouth
        Means,
        /// The mean of the mouth given the sound
        Posterior,
        /// The means of the best path's states
        Viterbi,
        /// Local linear maps
        LocalLinear,
    }
}

choice! {
    /// What of another voice is brought to the training voice's.
    Adaptation for lipstream::kinds::hierarchical::voice::Adaptation {
        /// Mean and variance of each speech parameter
        Level,
        /// Mean and covariance
        Linear,
    }
}

choice! {
    /// What chooses the cluster of a hierarchical model's picture.
    ClusterChoice for lipstream::kinds::hierarchical::Choice {
        /// Its own sound, by Mahalanobis distance
        Mahalanobis,
        /// The visual states of a coupled HMM
        Chmm,
        /// The mouth of a recurrent model
        Recurrent,
    }
}

choice! {
    /// Shapes that an animation program blends.
    BlendSet for lipstream::cues::BlendSet {
        /// The 15 visemes of Oculus lip sync
        Oculus,
        /// The 52 blend shapes of ARKit
        Arkit,
        /// The 22 viseme ids of Azure's speech service
        Azure,
        /// The visemes of Amazon Polly's American English
        Polly,
        /// The five vowels of VRM avatars
        Vrm,
        /// Action units of the lower face
        Facs,
    }
}

choice! {
    /// How long a mouth may wait for the sound that follows (`docs/design.md`, section 5).
    Profile for lipstream_core::wire::Profile {
        /// At most 45 ms
        Live,
        /// At most 80 ms
        Standard,
        /// Without limit
        Studio,
    }
}

choice! {
    /// What a clip is for.
    Split for lipstream_make::features::Split {
        /// Training
        Train,
        /// Validation: choices are made on it
        Val,
        /// Test: reported, never chosen on
        Test,
    }
}

choice! {
    /// A label format.
    Labels for lipstream_make::align::write::Format {
        /// HTK: start and end in 100 ns, phone, score, and the word at its first phone
        Lab,
        /// Praat: tiers "words" and "phones"
        Textgrid,
        /// TIMIT: phones in samples, the words in a .wrd file beside it
        Phn,
        /// Times in seconds
        Json,
    }
}

choice! {
    /// What the mouth's last output feeds into the visual emissions.
    Feedback for lipstream::kinds::recurrent::parameters::Feedback {
        /// Nothing: the sound alone moves the states
        None,
        /// The last mouth parameters
        Output,
        /// The last memory
        Memory,
    }
}

choice! {
    /// Which chain's states own tables.
    Gate for lipstream::kinds::recurrent::parameters::Gate {
        /// The phone states
        Audio,
        /// The viseme states
        Visual,
        /// Both
        Both,
    }
}

choice! {
    /// A format of numbers.
    Numbers for lipstream::out::Format {
        /// An array of parameters
        Npy,
        /// Rows of time, parameters and viseme weights
        Csv,
        /// One object with both
        Json,
    }
}

choice! {
    /// Whose mouth is put onto a recording.
    Whose for lipstream::render::face::Whose {
        /// The recording's, moved by the model's eigenmouths: the model was trained on whom it shows
        Trained,
        /// The recording's, chosen from its pictures by how open and wide the model's is
        Opened,
        /// The model's, in the recording's light
        Models,
    }
}

/// How a recording's fine detail is put onto mouths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Detail {
    /// Eigenmouths alone
    None,
    /// That of the most similar mouth, picture by picture
    Nearest,
    /// Chosen over time, so that it does not flicker
    Smooth,
}

/// What a recording's lower face follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Jaw {
    /// Nothing: it stays as it was recorded
    Still,
    /// The sound's energy
    Sound,
    /// The drawn mouth
    Mouth,
}
