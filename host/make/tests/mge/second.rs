//! A second memory beside a first: learnt, streamed, exported.
use super::*;
use lipstream::kinds::recurrent::gated::{Gated, Part, STRIDE};
use lipstream::kinds::recurrent::parameters::Group;
use lipstream_make::evaluate::metrics::Score;
use lipstream_make::mge::rounding::rounded;
use lipstream_make::mge::second::{self, GatedTape};

/// A first memory that has learnt little, and the settings of a second.
fn first(data: &Data, parent: &Model) -> (RecurrentModel, MgeTrainSettings) {
    let model = quietly(data, parent, &MgeTrainSettings { passes: 3, ..small() }, None);
    let settings = second::settings(
        &model,
        &MgeTrainSettings {
            passes: 12,
            memory: 14,
            ..small()
        },
    );
    (model, settings)
}

/// z `[T, Z]` that a clip becomes.
fn heard(model: &RecurrentModel, clip: &Clip, ahead: usize) -> Array2<f32> {
    let shape = &model.parameters.shape;
    let context = shape.context.stack_within(&clip.x, clip.x.nrows(), ahead);
    centred(&context, &model.context_mean).dot(&model.parameters.matrix(Group::Projection).t())
}

fn acc(model: &RecurrentModel, clips: &Store) -> f64 {
    let mut score = Score::new(OUTPUTS);
    for clip in every(clips) {
        let raw = &clip.x / &ndarray::ArrayView1::from(&model.scale);
        let said = live::convert(model, raw.view()).parameters;
        let truth = clip.mouth.unwrap() * ndarray::ArrayView1::from(&model.deviation);
        score.add(&truth, &said);
    }
    score.acc()
}

#[test]
fn two_memories_say_more_than_one() {
    let parent = parent();
    let data = data(&parent);
    let (model, settings) = first(&data, &parent);
    let both = second::train_on(&data, &model, &settings, None, &()).unwrap();
    assert!(
        both.parameters == model.parameters,
        "the first memory stays as it is"
    );
    let gated = both.gated.clone().unwrap();
    assert_eq!((gated.shape.memory, gated.shape.phones), (14, 0));
    assert!((0.2..=0.8).contains(&gated.share), "{}", gated.share);
    let (one, two) = (acc(&model, &data.validation), acc(&both, &data.validation));
    println!("ACC {one:.3} with one memory, {two:.3} with two");
    assert!(two > one + 0.02, "{one} with one memory, {two} with two");

    // Frame by frame as in batches.
    let net = Net::new(&model.parameters, &model.chain(), model.least);
    for (clip, ahead) in every(&data.validation).flat_map(|c| [8, 3].map(|ahead| (c.clone(), ahead))) {
        let z = heard(&model, &clip, ahead);
        let context = model
            .parameters
            .shape
            .context
            .stack_within(&clip.x, clip.x.nrows(), ahead);
        let one = Tape::forward(&net, centred(&context, &model.context_mean), Masks::default()).output;
        let two = GatedTape::forward(&gated, &z, &[]).output;
        let raw = &clip.x / &ndarray::ArrayView1::from(&model.scale);
        let said = live::convert_within(&both, raw.view(), ahead).parameters;
        for ((t, d), said) in said.indexed_iter() {
            let mean = one[[t, d]] + gated.share * (two[[t, d]] - one[[t, d]]);
            let deviation = both.deviation[d];
            assert!((said - mean * deviation).abs() < 2e-3 * deviation.max(1.0));
        }
    }

    // The device's integers follow, and a file gives it back.
    let (mouth, visemes) = apart(&both, &data.validation);
    println!("fixed point: {mouth:.4} of the mouth, visemes {visemes:.4}");
    assert!(mouth < 0.02 && visemes < 0.03, "{mouth} {visemes}");
    let scratch = tempfile::tempdir().unwrap();
    let path = scratch.path().join("m.safetensors");
    both.write(&path).unwrap();
    assert!(RecurrentModel::read(&path).unwrap().gated == both.gated);
    // One of its tensors is missing a row.
    let mut wrong = both.clone();
    if let Some(gated) = &mut wrong.gated {
        gated.shape.outputs -= 1;
        *gated = Gated::zeros(gated.shape);
    }
    wrong.write(&path).unwrap();
    let error = lipstream::error::chain(&RecurrentModel::read(&path).unwrap_err());
    assert!(error.contains("gated.output"), "{error}");

    // Eight bits are enough, two are not.
    let change = |bits: u32| {
        let rounded = rounded(&both, bits).gated.unwrap();
        let wrong = rounded
            .values
            .iter()
            .zip(&gated.values)
            .map(|(a, b)| (a - b).powi(2));
        wrong.sum::<f32>().sqrt()
    };
    assert!(change(8) > 0.0 && change(2) > 10.0 * change(8));
}

#[test]
fn an_interrupted_second_memory_goes_on_and_other_clips_are_refused() {
    let scratch = tempfile::tempdir().unwrap();
    let checkpoint = scratch.path().join("m.checkpoint");
    let parent = parent();
    let data = data(&parent);
    let (model, mut settings) = first(&data, &parent);
    settings.passes = 3;
    goes_on_to_the_same(&checkpoint, ["pass 2/", "going on after step"], |progress| {
        second::train_on(&data, &model, &settings, Some(&checkpoint), progress).unwrap()
    });

    let mut other = model.clone();
    other.deviation[0] *= 1.5;
    let error = second::train_on(&data, &other, &settings, None, &()).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("not those that the model was trained on"),
        "{error}"
    );
}

#[test]
fn the_frame_between_two_steps_has_a_mouth_of_its_own() {
    let mut gated = Gated::zeros(lipstream::kinds::recurrent::gated::GatedShape {
        inputs: 2,
        memory: 3,
        outputs: 1,
        phones: 0,
    });
    gated.of_mut(Part::LaterBias)[0] = 1.0;
    let said = GatedTape::forward(&gated, &Array2::zeros((2 * STRIDE + 1, 2)), &[]).output;
    assert_eq!(said.column(0).to_vec(), [0.0, 1.0, 0.0, 1.0, 0.0]);
}
