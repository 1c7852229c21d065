//! The errors for which photographs are refused, and the warnings about accepted ones.

use thiserror::Error;

use optics_model::Invalid;

use crate::frame::Colour;

/// Likely causes of [`Refusal::Unlike`], with the remedy.
pub(crate) const TURNED: &str = "the picture is turned, most likely by a viewer's automatic rotation; give the file as the \
                                 camera wrote it";
pub(crate) const UNLIKE: &str =
    "look for another slab or a turned picture (a viewer's automatic rotation), and shoot again";
pub(crate) const ONE_TURNED: &str = "one of the two is turned (a viewer's automatic rotation), or something moved; give \
                                     the files as the camera wrote them, or shoot again";

/// The reason why a session cannot be evaluated: the finding, its place, and the remedy.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Refusal {
    #[error(transparent)]
    Invalid(#[from] Invalid),
    #[error("{label}: {share:.1} % of the {colour} samples in {place} are clipped at {level}; expose less")]
    Clipped { label: String, colour: Colour, place: String, share: f64, level: f64 },
    #[error(
        "the {colour} samples are not linear: patch {patch} (ρ {rho}) is {deviation:+.2} % off the line through the \
         others, 1 % is allowed; check the order of the patches, switch off tone curves"
    )]
    NotLinear { colour: Colour, patch: usize, rho: f64, deviation: f64 },
    #[error(
        "{label}: the {colour} samples are {:.2} % {} those of the longest exposure in its time, 1 % is allowed; switch off tone \
         curves, expose less, or leave `exposures` out and give three grey patches",
        percent.abs(), if *percent < 0.0 { "below" } else { "above" }
    )]
    NotProportional { label: String, colour: Colour, percent: f64 },
    #[error(
        "linearity needs three exposure times of the white panel, the shortest at most half of the longest: {seen}; files must \
         state their time"
    )]
    FewExposures { seen: String },
    #[error(
        "{label}: the grey patches were not found: {seen}; they are looked for as a row of even rectangles at equal \
         distances, in the order of rho; check that order, or give their places with `areas_px`"
    )]
    NoPatches { label: String, seen: String },
    #[error(
        "{label}: brightness rises as the {exponent:.2}th power of ρ: this picture is gamma-coded; give the raw file, \
         or convert it without a tone curve"
    )]
    GammaCoded { label: String, exponent: f64 },
    #[error(
        "{label}: {share:.0} % of the samples are 0: the black level is already subtracted and the noise cut \
         off; give the raw file"
    )]
    BlackSubtracted { label: String, share: f64 },
    #[error(
        "{label}: the black level is unknown: add dark shots (`dark` under [camera], `--darks` with --check), or give \
         files that contain it"
    )]
    BlackUnknown { label: String },
    #[error(
        "{label}: the edge is blurred by {blur_px:.2} px, {times:.2} times the session's {session_px:.2} px, 1.3 times \
         are allowed; focus again, and avoid any movement"
    )]
    Defocused { label: String, blur_px: f64, session_px: f64, times: f64 },
    #[error(
        "{label}: edges are blurred by {across_px:.2} px sideways and {along_px:.2} px up and down, 1.3 times are \
         allowed: something moved during the exposure; use a remote release"
    )]
    Shaken { label: String, across_px: f64, along_px: f64 },
    #[error(
        "{label}: the board lies ({dx_px:+.2}, {dy_px:+.2}) px away from its place in the bare shots, {allowed_px:.2} \
         px are allowed; if camera or board moved, shoot the bare board again; if a viewer turned one of the pictures, \
         give the files as the camera wrote them"
    )]
    Moved { label: String, dx_px: f64, dy_px: f64, allowed_px: f64 },
    #[error(
        "{label}: the slab's rim crosses the crop at {x_mm:+.1} mm from the edge, {y_mm:+.1} mm along it; cover at \
         least 5 mm on each side of the edge"
    )]
    RimInCrop { label: String, x_mm: f64, y_mm: f64 },
    #[error(
        "{label}: the border of a square crosses the crop: {room_mm:.1} mm of the edge are free to one side, \
         {needed_mm:.1} mm are needed; move the edge to the frame's middle, or use larger squares"
    )]
    BorderInCrop { label: String, room_mm: f64, needed_mm: f64 },
    #[error(
        "{label}: thirds of the crop disagree in {colour}: {deviation:+.4} at {x_mm:+.1} mm, {z:.0} standard errors; \
         {advice} for bubbles, dust, a tilted slab"
    )]
    ThirdsDisagree { label: String, colour: Colour, x_mm: f64, deviation: f64, z: f64, advice: &'static str },
    #[error(
        "{label}: the edge bends by {bend_px:.2} px within the crop, {allowed_px:.2} px are allowed; lay the board \
         flat, move the edge to the frame's middle"
    )]
    EdgeBent { label: String, bend_px: f64, allowed_px: f64 },
    #[error(
        "{label}: the edge is turned by {angle_deg:+.2}° against the pixels, at least {needed_deg:.2}° are needed to \
         sample it at all their phases; turn the board a little"
    )]
    NotSlanted { label: String, angle_deg: f64, needed_deg: f64 },
    #[error(
        "the light drifted by {percent:+.2} % in {colour} between {first} and {last}, 2 % are allowed; let the lamps \
         warm up, shoot the patches more often"
    )]
    LightDrifted { colour: Colour, percent: f64, first: String, last: String },
    #[error(
        "{label}: the free board's light differs by {percent:+.1} % in {colour} from the bare shots', up to {allowed} \
         % are divided out: light or exposure changed; keep both constant, and repeat this shot or the bare board"
    )]
    LightChanged { label: String, colour: Colour, percent: f64, allowed: f64 },
    #[error(
        "{label}: light and dark squares of the free board are brighter by {percent:+.1} % of white in {colour} than in the bare \
         shots, up to {allowed} % are subtracted: the black level or stray light changed; shade the lens, let the camera warm \
         up, and repeat this shot or the bare board"
    )]
    LightAdded { label: String, colour: Colour, percent: f64, allowed: f64 },
    #[error(
        "{label}: the light over the board rises by {percent:+.1} % per 10 mm in {colour} against {since}; up to {allowed} % are \
         divided out: leave the lamps where they are, and repeat the flat, the board or this shot"
    )]
    LightTurned { label: String, colour: Colour, percent: f64, allowed: f64, since: &'static str },
    #[error(
        "{label}: the dark side of the edge is {found}, but {expected} in the session file; change `dark_side`, or give the \
         file as the camera wrote it, if a viewer turned it"
    )]
    SidesSwapped { label: String, found: Side, expected: Side },
    #[error(
        "{label}: no edge of a board was found: {seen}; light evenly, fill the frame's middle with the edge"
    )]
    NoBoard { label: String, seen: String },
    #[error("{label}: the scale is unknown: {seen}; show at least two parallel edges of the board")]
    NoScale { label: String, seen: String },
    #[error(
        "{label}: the crop leaves the frame at ({x_px:.0}, {y_px:.0}) px; move the edge to the frame's middle"
    )]
    OutsideFrame { label: String, x_px: f64, y_px: f64 },
    #[error(
        "{label}: slip and gel show {percent:.1} % of white in {colour} where a light trap is expected, up to {allowed:.1} % are \
         allowed; lay them over a deep black hole (a box lined with black velvet), in the board's place"
    )]
    NoTrap { label: String, colour: Colour, percent: f64, allowed: f64 },
    #[error(
        "{label}: no straight edge between two even sides crosses the middle of the crop; lay chrome on glass, or another edge \
         that spreads no light, along the board's edge and in its plane"
    )]
    NoOwnEdge { label: String },
    #[error(
        "{label}: {seen}; shoot the slab with a filter before the lamps that blocks blue (yellow), and leave a part of the board \
         free"
    )]
    NoBlueCut { label: String, seen: String },
    #[error(
        "the other edge is blurred by {known_mm:.4} mm in {colour}, the board's by {board_mm:.4}, so that it lies out of focus; \
         lay it in the board's plane"
    )]
    EdgeOutOfFocus { colour: Colour, known_mm: f64, board_mm: f64 },
    #[error(
        "{label}: in red the slab has {percent:.1} % more light without blue, as another slab has; shoot the same slab"
    )]
    BrighterWithoutBlue { label: String, percent: f64 },
    #[error("{label}: the crop looks like the bare board; cover the edge with the slab")]
    NoSlab { label: String },
    #[error(
        "{label}: {what} is {found}, but {expected} in the shots before; use one camera with fixed settings"
    )]
    Mixed { label: String, what: &'static str, found: String, expected: String },
    #[error(
        "{label}: the noise of {one} is opposite to that of {other} (correlation {correlation:.2}), so a colour matrix has mixed \
         the channels; give the raw file, or develop without a colour space and balance (`dcraw -4 -T -o 0 -r 1 1 1 1`)"
    )]
    MixedColours { label: String, one: Colour, other: Colour, correlation: f64 },
    #[error(
        "{label}: samples repeat after four pixels and not after two: a mosaic of 2 × 2 pixels of one colour (quad Bayer), or rows \
         of two sensitivities (dual ISO); set the camera to binned output, or to one ISO"
    )]
    FourPixels { label: String },
    #[error("{label}: {seen}: {cause}")]
    Unlike { label: String, seen: String, cause: &'static str },
    #[error("there are no {what}, and nothing can replace them")]
    Missing { what: &'static str },
}

/// A doubt that is reported with the result.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Warning {
    #[error(
        "{what}: {count} shots are too few to estimate the error between mountings; mount the slab at least three times"
    )]
    FewShots { what: String, count: usize },
    #[error(
        "brightness rises by {percent:.1} % per 10 mm more in {labels} than on the mean, and falls in the other shots, as for a \
         wedge that was turned by 180°: both sides are averaged with the same weight"
    )]
    Turned { labels: String, percent: f64 },
    #[error(
        "light spreads within the board by {mm:.3} ± {std_error_mm:.3} mm, as in paper and film; the fit allows for it, but a \
         board that does not (chrome on glass, anodised metal) gives narrower intervals"
    )]
    SpreadingBoard { mm: f64, std_error_mm: f64 },
    #[error(
        "under gel the board's light side reflects {wet:.3} ± {std_error:.3}, dry {dry:.3}: the difference is gloss; the fit \
         takes the value under gel"
    )]
    Gloss { wet: f64, std_error: f64, dry: f64 },
    #[error("no dark shots: the black level is taken from the files, without an error")]
    NoDark,
    #[error(
        "the black level is already subtracted; where the board is as dark as the noise, its light is overestimated"
    )]
    BlackSubtracted,
    #[error(
        "no flat shots: uneven light is not corrected; a slope of {slope_percent} % per 10 mm is allowed for"
    )]
    NoFlat { slope_percent: f64 },
    #[error(
        "{label}: no part of the board is free of the slab, so movement and a change of the light since the bare shots \
         could not be checked"
    )]
    Unchecked { label: String },
    #[error("{label}: the free parts of the board do not show whether it moved {direction}")]
    HalfChecked { label: String, direction: &'static str },
    #[error(
        "{label}: the free parts of the board do not show whether the light has changed since the bare shots"
    )]
    LightUnchecked { label: String },
    #[error("{labels}: {change}: by {percent:+.2} % in {colour} at most")]
    LightCorrected { labels: String, change: Correction, colour: Colour, percent: f64 },
    #[error(
        "the light over the bare board is not that of the flat shots: in {colour} it rises by {percent:+.2} % per 10 mm, or \
         bends; this is divided out as the lamps', which should stay in place; a board whose print is uneven looks alike"
    )]
    UnevenBoard { colour: Colour, percent: f64 },
    #[error(
        "{label}: {share:.1} % of the crop masked for {} of up to {area_mm2:.2} mm², {x_mm:+.1} mm from the edge",
        if *count == 1 { "a speck or scratch".to_owned() } else { format!("{count} specks or scratches") }
    )]
    Masked { label: String, count: usize, share: f64, area_mm2: f64, x_mm: f64 },
    #[error("{label}: no light: a dark shot, which sessions list under `dark`; with light, expose longer")]
    DarkShot { label: String },
    #[error(
        "the board's dark side is darker than a black base under the scene's coat: ρ = {}; the coat mirrors less of the lamps \
         than the scene's, and its roughness is estimated in the fit",
        rho.iter().map(|(colour, rho)| format!("{rho:.4} in {colour}")).collect::<Vec<_>>().join(", ")
    )]
    DarkerThanBlack { rho: Vec<(Colour, f64)> },
    #[error("left out: {why}")]
    LeftOut { why: Box<Refusal> },
    #[error("{label}: {share:.1} % of the crop's samples were rejected as dust or scratches")]
    ManyRejected { label: String, share: f64 },
    #[error(
        "{label}: the brightest {colour} samples reach {percent:.0} % of the sensor's range; expose longer"
    )]
    Dim { label: String, colour: Colour, percent: f64 },
    #[error("{label}: no free edge of the board, so its sharpness was not checked")]
    NoFreeEdge { label: String },
    #[error("the photographs are demosaiced: their neighbours are correlated and their errors too small")]
    Demosaiced,
    #[error(
        "{label}: red, green and blue agree within noise: they are one channel, as from a monochrome camera or from \
         grey stored as RGB; use one of the three results"
    )]
    OneColour { label: String },
    #[error("the fit of {what} did not converge: its value and its error may be wrong")]
    NotConverged { what: &'static str },
    #[error("noise was estimated from single photographs, since no shot was repeated")]
    NoPairs,
    #[error("times of the shots are unknown: the white reference is the mean of its shots")]
    NoTimes,
    #[error(
        "{patches} do not show whether numbers are proportional to light: an error of 1 % is allowed for; add shots of the \
         white at other exposure times (`exposures` under [neutral]), or grey patches"
    )]
    LinearityUnknown { patches: &'static str },
    #[error(
        "one patch does not show how much light lens and camera scatter over the frame: {percent} ± {percent} % of its mean is \
         assumed; add a black patch"
    )]
    GlareUnknown { percent: f64 },
    #[error(
        "the light drifted by {percent:+.2} % in {colour} between the shots of the patches, which widens the error of all values; \
         let the lamps warm up, shoot the patches more often"
    )]
    Drifted { colour: Colour, percent: f64 },
    #[error("no shots of the patches after the samples: drift of the light is unknown")]
    NoDrift,
}

/// A side of the edge in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    Left,
    Right,
    Top,
    Bottom,
}

impl std::fmt::Display for Side {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "top",
            Self::Bottom => "bottom",
        })
    }
}

/// A correction of the light of a shot to that of the bare shots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Correction {
    Factor,
    Offset,
    Slope,
}

impl std::fmt::Display for Correction {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Factor => "the free board is brighter or darker than in the bare shots, which is divided out",
            Self::Offset => {
                "dark and light squares of the free board are brighter or darker alike, as by a black level that drifts or by stray light, \
                 which is subtracted, in shares of white"
            }
            Self::Slope => {
                "the light over the free board has turned since the bare shots, which is divided out, per 10 mm"
            }
        })
    }
}

impl Warning {
    /// Whether it only reports what was corrected, so that nothing has to be done.
    pub fn is_note(&self) -> bool {
        matches!(self, Self::Masked { .. })
    }
}
