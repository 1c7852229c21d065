//! Recognises the subjects of photographs without a session file.

use farm_tests::photograph::{Board, Camera, Edge, Session, Slab, What};
use optics_capture::{BoardGlance, Darks, FrameNumbers, Photo, ShotContent, board_subjects, content};

use super::stage::{PLAIN, board, shots, slab, white};

fn darks(session: &Session) -> Darks {
    let mut darks = Darks::new();
    shots(session, What::Dark, 2, &PLAIN).into_iter().try_for_each(|photo| darks.add(photo)).unwrap();
    darks
}

/// A board under something that leaves a share of its light and adds some.
fn under(share: f64, added: f64) -> Edge {
    Edge::new(move |c, x| {
        let light = if x > 0.0 { board().light[c] } else { board().dark[c] };
        light * share + added
    })
}

/// Dark shots, sheets, patches, a panel and light traps, in light that changes by 6 % across the frame.
#[test]
fn plain_shots_are_recognised_by_content() {
    let camera = Camera { slope: [0.06, -0.03], ..Camera::default() };
    let mut session = Session::new(camera.clone(), slab());
    let (darks, most) = (darks(&session), FrameNumbers::of(&session.shoot(What::Sheet, 0, &PLAIN)).most());
    let seen = |photo: &Photo| content(photo, darks.clone(), most).unwrap();
    let shot = |session: &Session, what| session.shoot(what, 5, &PLAIN);
    assert!(matches!(seen(&shot(&session, What::Dark)), ShotContent::Dark));
    let may_be_dark = |what| FrameNumbers::of(&session.shoot(what, 5, &PLAIN)).may_be_dark(most);
    assert_eq!([What::Dark, What::Sheet, What::Bare].map(may_be_dark), [true, false, false]);
    assert!(matches!(seen(&shot(&session, What::Sheet)), ShotContent::Even));
    assert!(matches!(seen(&shot(&session, What::Chart)), ShotContent::Patches(6)));
    for what in [What::Bare, What::Slab] {
        assert!(matches!(seen(&shot(&session, what)), ShotContent::Board(_)), "{what:?}");
    }
    let grey = Board { light: [0.05; 3], dark: [0.05; 3], ..board() };
    let panel =
        Slab { board: grey, edge: Edge::new(|_, _| 0.9), rim_mm: [-6.0, 7.0, -5.0, 5.0], bubble: None };
    session.lay(&camera, &panel);
    assert!(matches!(seen(&shot(&session, What::Slab)), ShotContent::Patches(1)), "a panel");
    for haze in [0.001, 0.004, 0.02] {
        let trap = Slab { edge: Edge::new(move |_, _| haze), rim_mm: [-60.0, 60.0, -60.0, 60.0], ..slab() };
        session.lay(&camera, &trap);
        assert!(matches!(seen(&shot(&session, What::Slab)), ShotContent::Dim), "haze {haze}");
    }
}

/// Slabs differ if their profiles differ by some hundredths, and are one if they were laid down 1 mm off. The bare board
/// has the most contrast, also among white slabs, clear ones, and ones that let no light through; gel lowers it a little.
#[test]
fn board_shots_are_grouped_by_slab() {
    let camera = Camera::default();
    let mut session = Session::new(camera.clone(), slab());
    let (darks, most) = (darks(&session), FrameNumbers::of(&session.shoot(What::Sheet, 0, &PLAIN)).most());
    let glance = |photo: Photo| -> BoardGlance {
        let ShotContent::Board(glance) = content(&photo, darks.clone(), most).unwrap() else {
            panic!("{}", photo.label)
        };
        glance
    };
    let rims = [[-12.0, 12.0, -8.2, 8.2], [-11.0, 13.0, -8.8, 7.6], [-12.6, 11.4, -7.5, 8.9]];
    let thicker = Edge::new(|c, x| white(c, 0.8 * x) * 0.97 + 0.02);
    let edges =
        [Edge::new(white), thicker, under(0.93, 0.0), under(0.75, 0.004), under(0.02, 0.03), under(0.1, 0.6)];
    let mut glances: Vec<BoardGlance> =
        shots(&session, What::Bare, 2, &PLAIN).into_iter().map(glance).collect();
    for edge in edges {
        for (i, rim_mm) in rims.into_iter().enumerate() {
            session.lay(&camera, &Slab { edge: edge.clone(), rim_mm, ..slab() });
            glances.push(glance(session.shoot(What::Slab, i as u64, &PLAIN)));
        }
    }
    // The order of the photographs does not matter.
    glances.rotate_left(5);
    let (mut subjects, transparent) = board_subjects(&glances);
    subjects.rotate_right(5);
    let numbers: Vec<usize> =
        std::iter::once(subjects[0]).chain(subjects[2..].chunks(3).map(|s| s[0])).collect();
    let expected: Vec<usize> =
        [vec![numbers[0]; 2], numbers[1..].iter().flat_map(|n| [*n; 3]).collect()].concat();
    assert_eq!(subjects, expected, "shots of one subject have one number");
    assert_eq!(numbers.iter().collect::<std::collections::BTreeSet<_>>().len(), 7, "{numbers:?}");
    assert_eq!((numbers[0], transparent), (0, vec![numbers[3]]), "bare, and under gel");
}
