//! Draws a board to print: squares of 40 mm around one edge.

/// An A4 sheet across, in mm.
const SHEET_MM: [f64; 2] = [297.0, 210.0];

/// Side of a square in mm: around the edge in the middle it is a half-plane for light that travels up to 10 mm.
const SQUARE_MM: f64 = 40.0;

/// An even number across and an odd number down, so that an edge runs through the middle of the board.
const SQUARES: [usize; 2] = [4, 3];

/// A black rectangle in mm from the sheet's upper left corner.
struct Rectangle {
    x: f64,
    y: f64,
    width: f64,
    height: f64,
}

/// All black areas of the sheet.
fn black() -> Vec<Rectangle> {
    let (left, top) = corner();
    let square = |row: usize, column: usize| Rectangle {
        x: left + column as f64 * SQUARE_MM,
        y: top + row as f64 * SQUARE_MM,
        width: SQUARE_MM,
        height: SQUARE_MM,
    };
    // The square to the left of the middle is black.
    let squares = (0..SQUARES[1]).flat_map(|row| (0..SQUARES[0]).map(move |column| (row, column)));
    let squares =
        squares.filter(|(row, column)| (row + column) % 2 == 0).map(|(row, column)| square(row, column));
    squares.chain(scale(left, top + height_mm() + 22.0)).collect()
}

fn height_mm() -> f64 {
    SQUARES[1] as f64 * SQUARE_MM
}

/// Upper left corner of the board.
fn corner() -> (f64, f64) {
    (0.5 * (SHEET_MM[0] - SQUARES[0] as f64 * SQUARE_MM), 0.5 * (SHEET_MM[1] - height_mm()) - 10.0)
}

/// A scale of 100 mm with a mark every 10 mm, to check the size of the print.
fn scale(left: f64, top: f64) -> Vec<Rectangle> {
    let mark = |i: u32| Rectangle {
        x: left + 10.0 * f64::from(i) - 0.05,
        y: top - if i.is_multiple_of(5) { 5.0 } else { 3.0 },
        width: 0.1,
        height: if i.is_multiple_of(5) { 5.0 } else { 3.0 },
    };
    let line = Rectangle { x: left, y: top, width: 100.0, height: 0.2 };
    (0..=10).map(mark).chain([line]).collect()
}

fn words() -> [String; 2] {
    [
        format!(
            "square_mm = {SQUARE_MM}: use the edge in the middle. Print at 100 %, without scaling, on matt paper or film; glue it flat."
        ),
        "This scale should be 100 mm long. If it is not, multiply square_mm by its length over 100."
            .to_owned(),
    ]
}

/// The sheet as SVG or PDF; `None` for other extensions.
pub fn board_sheet(extension: &str) -> Option<Vec<u8>> {
    match extension {
        "svg" => Some(svg().into_bytes()),
        "pdf" => Some(pdf()),
        _ => None,
    }
}

fn svg() -> String {
    let [width, height] = SHEET_MM;
    let rectangles = black().into_iter().map(|r| {
        format!(
            "<rect x=\"{:.3}\" y=\"{:.3}\" width=\"{:.3}\" height=\"{:.3}\"/>\n",
            r.x, r.y, r.width, r.height
        )
    });
    let [first, second] = words();
    let (left, top) = corner();
    let below = top + height_mm() + 22.0;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" viewBox=\"0 0 {width} {height}\" \
         shape-rendering=\"geometricPrecision\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n{}\
         <g font-family=\"sans-serif\" font-size=\"3.2\">\n<text x=\"{:.1}\" y=\"{:.1}\">{first}</text>\n\
         <text x=\"{:.1}\" y=\"{:.1}\">{second}</text>\n</g>\n</svg>\n",
        rectangles.collect::<String>(),
        left,
        top - 6.0,
        left,
        below + 6.0,
    )
}

/// PDF 1.4 with one page and Helvetica, which every reader contains.
fn pdf() -> Vec<u8> {
    const POINT: f64 = 72.0 / 25.4;
    let [width, height] = SHEET_MM.map(|mm| mm * POINT);
    let flipped = |y_mm: f64| (SHEET_MM[1] - y_mm) * POINT;
    let mut drawing = "0 g\n".to_owned();
    for r in black() {
        let numbers = [r.x * POINT, flipped(r.y + r.height), r.width * POINT, r.height * POINT];
        drawing += &format!("{} re f\n", numbers.map(|v| format!("{v:.4}")).join(" "));
    }
    let (left, top) = corner();
    for (text, y_mm) in words().iter().zip([top - 6.0, top + height_mm() + 28.0]) {
        drawing += &format!("BT /F 9 Tf {:.2} {:.2} Td ({text}) Tj ET\n", left * POINT, flipped(y_mm));
    }
    let objects = [
        "<< /Type /Catalog /Pages 2 0 R >>".to_owned(),
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>".to_owned(),
        format!(
            "<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4} {height:.4}] /Contents 4 0 R \
             /Resources << /Font << /F << /Type /Font /Subtype /Type1 /BaseFont /Helvetica >> >> >> >>"
        ),
        format!("<< /Length {} >>\nstream\n{drawing}endstream", drawing.len()),
    ];
    let mut file = "%PDF-1.4\n".to_owned();
    let mut places = Vec::new();
    for (i, object) in objects.iter().enumerate() {
        places.push(file.len());
        file += &format!("{} 0 obj\n{object}\nendobj\n", i + 1);
    }
    let start = file.len();
    file += &format!("xref\n0 {}\n0000000000 65535 f \n", objects.len() + 1);
    file += &places.iter().map(|place| format!("{place:010} 00000 n \n")).collect::<String>();
    file += &format!("trailer\n<< /Size {} /Root 1 0 R >>\nstartxref\n{start}\n%%EOF\n", objects.len() + 1);
    file.into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The middle edge separates a black from a white square of 40 mm, and all marks are within the printable area.
    #[test]
    fn middle_edge_of_board_has_40_mm() {
        let (left, top) = corner();
        let middle = [left + 0.5 * SQUARES[0] as f64 * SQUARE_MM, top + 0.5 * height_mm()];
        let is_black = |dx: f64, dy: f64| {
            let (x, y) = (middle[0] + dx, middle[1] + dy);
            black().iter().any(|r| (r.x..r.x + r.width).contains(&x) && (r.y..r.y + r.height).contains(&y))
        };
        for dy in [-19.9, 0.0, 19.9] {
            assert_eq!([-39.9, -0.1, 0.1, 39.9].map(|dx| is_black(dx, dy)), [true, true, false, false]);
        }
        assert!(
            !is_black(-0.1, 20.1) && is_black(0.1, -20.1),
            "the squares above and below are the other way round"
        );
        let sound =
            |r: &Rectangle| r.x > 10.0 && r.y > 10.0 && r.x + r.width < 287.0 && r.y + r.height < 200.0;
        assert!(black().iter().all(sound), "all is within what printers print");
    }

    /// The objects of the PDF are at the offsets of its table.
    #[test]
    fn pdf_objects_are_at_their_listed_offsets() {
        let file = String::from_utf8(pdf()).unwrap();
        let (_, xref) = file.split_once("xref\n0 5\n").unwrap();
        for (i, line) in xref.lines().skip(1).take(4).enumerate() {
            let place: usize = line[..10].parse().unwrap();
            assert!(file[place..].starts_with(&format!("{} 0 obj", i + 1)), "{line}");
        }
        let (_, rest) = file.split_once("/Length ").unwrap();
        let length: usize = rest[..rest.find(' ').unwrap()].parse().unwrap();
        let stream = rest.find("stream\n").unwrap() + 7;
        assert!(rest[stream + length..].starts_with("endstream"));
    }
}
