//! Compares corruptions with LIBERO-Plus' own code, by digests of `recorded/corruptions.py`.

use benchmark::family::corruption::{Corruption, Kind, Picture};
use benchmark::numpy::LegacyRng;
use sha2::{Digest, Sha256};

const RECORDED: &str = include_str!("recorded/corruptions.txt");

/// Returns the same picture as the recording script.
fn picture(side: usize) -> Vec<u8> {
    let mut noise = LegacyRng::seed(side as u32);
    let mut rgb = Vec::with_capacity(side * side * 3);
    for row in 0..side {
        for column in 0..side {
            let noise = [(); 3].map(|()| noise.randint(256) as usize);
            let block = (row / 8) * (side / 16) + column / 16;
            let pixel = match (row < side / 2, column < side / 2) {
                (true, _) => [block % 256, 255 - block % 256, block * 7 % 256],
                (false, true) => [row, column, row + column].map(|part| part * 255 / (2 * side)),
                (false, false) => noise,
            };
            rgb.extend(pixel.map(|part| part as u8));
        }
    }
    rgb
}

fn check(kind: Kind) {
    let mut checked = 0;
    for line in RECORDED.lines() {
        let fields: Vec<&str> = line.split(' ').collect();
        let [number, side, first, second, next] = fields[..] else {
            panic!("{line}");
        };
        let side: usize = side.parse().unwrap();
        let number: u8 = number.parse().unwrap();
        let corruption = Corruption::new(number).unwrap();
        if corruption.kind() != kind {
            continue;
        }
        let mut rng = LegacyRng::seed(1000 + u32::from(number));
        for expected in [first, second] {
            let mut rgb = picture(side);
            let mut picture = Picture { height: side, width: side, rgb: &mut rgb };
            corruption.apply(&mut picture, &mut rng).unwrap();
            let digest = hex::encode(&Sha256::digest(&rgb)[..8]);
            assert_eq!(digest, expected, "{number} ({corruption}) at {side} pixels");
        }
        let mut skipping = LegacyRng::seed(1000 + u32::from(number));
        corruption.skip(side, side, &mut skipping);
        corruption.skip(side, side, &mut skipping);
        assert!(skipping == rng, "{number}: skip consumes as many numbers as apply");
        let next: f64 = next.parse().unwrap();
        assert_eq!(rng.random_sample(), next, "{number}: the generator has the recorded state");
        checked += 1;
    }
    // Ten severities at two sizes.
    assert_eq!(checked, 20);
}

#[test]
fn motion_blur_equals_imagemagicks() {
    check(Kind::Motion);
}

#[test]
fn gaussian_blur_equals_scikit_images() {
    check(Kind::Gaussian);
}

#[test]
fn zoom_blur_equals_the_released_codes() {
    check(Kind::Zoom);
}

#[test]
fn fog_equals_the_released_codes() {
    check(Kind::Fog);
}

#[test]
fn glass_blur_equals_the_released_codes() {
    check(Kind::Glass);
}

#[test]
fn pictures_of_unsupported_size_are_refused_and_unchanged() {
    let mut rng = LegacyRng::seed(1);
    let initial = rng.clone();
    let mut rgb = vec![7; 300 * 300 * 3];
    let mut large = Picture { height: 300, width: 300, rgb: &mut rgb };
    let fog = Corruption::new(31).unwrap();
    let error = fog.apply(&mut large, &mut rng).unwrap_err().to_string();
    assert!(
        error.contains("300×300")
            && error.contains("`fog`, which supports only pictures of at most 256"),
        "{error}"
    );
    let zoom = Corruption::new(21).unwrap();
    let error = zoom.check(300, 200, 300 * 200 * 3).unwrap_err().to_string();
    assert!(error.contains("`zoom`, which supports only square pictures of at least 2"), "{error}");
    assert!(rng == initial && rgb.iter().all(|byte| *byte == 7));
    assert_eq!(Corruption::new(0), None);
    assert_eq!(Corruption::new(51), None);
}
