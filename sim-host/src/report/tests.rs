use super::*;
use crate::flight::{Crash, Flight};
use crate::scene::BUILT_IN;

fn fly(scene: &Scene) -> (Outcome, Recorder) {
    let mut recorder = Recorder::new();
    let outcome = Flight::new(scene, scene.seed).run(&mut recorder);
    (outcome, recorder)
}

fn page_of(scene: &Scene) -> String {
    let (outcome, recorder) = fly(scene);
    page(scene, scene.seed, &outcome, &recorder)
}

fn hover() -> Scene {
    Scene::load("hover").unwrap()
}

/// Asserts that every element is closed in order, and that the text contains no unescaped `<` or `&`.
fn assert_well_formed(html: &str) {
    let (_, body) = html.split_once("</style>").unwrap();
    let mut open = vec!["html", "head"];
    for piece in body.split('<').skip(1) {
        let (tag, text) = piece.split_once('>').expect("a tag ends");
        assert!(!text.contains('>'), "{text}");
        for entity in text.split('&').skip(1) {
            let (name, _) = entity.split_once(';').expect("an entity ends");
            assert!(["amp", "lt", "gt", "quot", "#39"].contains(&name), "&{name};");
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        let name = tag.split([' ', '/']).find(|part| !part.is_empty()).unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name));
        } else if !tag.ends_with('/') && name != "br" {
            open.push(name);
        }
    }
    assert_eq!(open, [""; 0]);
}

#[test]
fn page_of_every_scene_is_well_formed_and_self_contained() {
    for built_in in BUILT_IN {
        let scene = Scene::load(built_in.name).unwrap();
        let html = page_of(&scene);
        assert_well_formed(&html);
        for word in ["http:", "https:", "<script", "<img", "<link", "url(", "@import", "href", "NaN", "inf\""]
        {
            assert!(!html.contains(word), "{}: {word}", built_in.name);
        }
        for effect in scene.effects() {
            assert!(html.contains(&format!("<code>{effect}</code>")), "{}: {effect}", built_in.name);
        }
    }
}

#[test]
fn same_scene_and_seed_give_the_same_bytes() {
    let mut scene = hover();
    let first = page_of(&scene);
    assert_eq!(first, page_of(&scene));
    scene.seed += 1;
    assert_ne!(first, page_of(&scene));
}

#[test]
fn text_of_a_scene_file_is_escaped() {
    let hostile = "</title><script>alert(1)</script>\" onload='x' &lt;";
    let mut scene = hover();
    scene.name = hostile.into();
    scene.description = hostile.into();
    let html = page_of(&scene);
    assert_well_formed(&html);
    assert!(!html.contains("<script") && !html.contains("\" onload"));
    assert!(html.contains("&lt;/title&gt;&lt;script&gt;alert(1)&lt;/script&gt;&quot; onload='x' &amp;lt;"));
}

#[test]
fn figures_without_data_are_left_out() {
    let titles = |name: &str| -> Vec<&str> {
        let scene = Scene::load(name).unwrap();
        let (outcome, recorder) = fly(&scene);
        figures::all(&scene, &outcome, &recorder).iter().map(|figure| figure.title).collect()
    };
    let all = ["Attitude", "Attitude error", "Body rates", "Motors", "Height and position"];
    assert_eq!(titles("hover"), all);
    assert_eq!(titles("stand-steps"), all[..4]);
    assert_eq!(titles("static"), all[..3]);
}

#[test]
fn crash_is_named_and_marked() {
    let scene = hover();
    let (mut outcome, recorder) = fly(&scene);
    assert!(page(&scene, 7, &outcome, &recorder).contains("flown to the end"));
    outcome.crash = Some((Crash::TippedOver, 5.5));
    let html = page(&scene, 7, &outcome, &recorder);
    assert!(html.contains("crashed at 5.500 s: tilt above 90°") && !html.contains("flown to the end"));
    assert!(html.contains(">crash</text>"));
}

#[test]
fn non_finite_outcome_is_shown_in_words() {
    let scene = hover();
    let (outcome, recorder) = fly(&scene);
    let outcome = Outcome { attitude_rmse_deg: f64::NAN, position_error_max_m: f64::INFINITY, ..outcome };
    let html = page(&scene, 7, &outcome, &recorder);
    assert_eq!(html.matches("not finite").count(), 2);
    assert!(!html.contains("NaN"));
}

#[test]
fn report_file_contains_the_page() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("report.html");
    let scene = hover();
    let (outcome, recorder) = fly(&scene);
    write(&path, &scene, 9, &outcome, &recorder).unwrap();
    assert_eq!(std::fs::read_to_string(&path).unwrap(), page(&scene, 9, &outcome, &recorder));
    let error =
        write(directory.path().join("missing/report.html"), &scene, 9, &outcome, &recorder).unwrap_err();
    assert!(error.to_string().contains("cannot be written"), "{error}");
}
