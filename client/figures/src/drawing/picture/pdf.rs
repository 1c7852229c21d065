//! Writes shapes as a page of PDF, with the fonts of its texts embedded.

use anyhow::Context as _;
use miniz_oxide::deflate::compress_to_vec_zlib;
use pdf_writer::types::{CidFontType, FontFlags, LineCapStyle, LineJoinStyle, SystemInfo, UnicodeCmap};
use pdf_writer::{Content, Filter, Name, Pdf, Rect, Ref, Settings, Str};
use subsetter::GlyphRemapper;
use tiny_skia::{PathSegment, Pixmap, Point};
use ttf_parser::GlyphId;

use super::Picture;
use super::png::outline;
use crate::drawing::rgb::Rgb;
use crate::drawing::shape::{Shape, ShapeKind, Stroke, Style};
use crate::drawing::text::{Glyph, Text, face};

const SETTINGS: Settings = Settings { pretty: false };
const IDENTITY: SystemInfo =
    SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"Identity"), supplement: 0 };
/// Regular and bold, by the names of their resources and by their own.
const FONTS: [(Name, &str); 2] = [(Name(b"R"), "DejaVuSans"), (Name(b"B"), "DejaVuSans-Bold")];
/// How much is done to compress, from 0 to 10.
const EFFORT: u8 = 6;

/// The picture on a page of a size in points.
pub(super) fn write(picture: &Picture, width: f32, height: f32) -> anyhow::Result<Vec<u8>> {
    let mut drawing = PdfDrawing {
        content: Content::with_settings(SETTINGS),
        images: Vec::new(),
        fonts: [PdfFont::default(), PdfFont::default()],
    };
    let scale = (f64::from(width) / picture.width) as f32;
    drawing.content.transform([scale, 0.0, 0.0, -scale, 0.0, height]);
    drawing.content.set_fill_gray(1.0).rect(0.0, 0.0, px(picture.width), px(picture.height)).fill_nonzero();
    for shape in &picture.shapes {
        drawing.shape(shape);
    }

    let mut pdf = Pdf::with_settings(SETTINGS);
    let mut next = Ref::new(1);
    let [catalog, pages, page, content] = [(); 4].map(|()| next.bump());
    pdf.catalog(catalog).pages(pages);
    pdf.pages(pages).kids([page]).count(1);
    let data = compress_to_vec_zlib(&drawing.content.finish(), EFFORT);
    pdf.stream(content, &data).filter(Filter::FlateDecode);
    let mut fonts = Vec::new();
    for (font, bold) in drawing.fonts.iter().zip([false, true]).filter(|(font, _)| !font.glyphs.is_empty()) {
        fonts.push(font.write(&mut pdf, &mut next, bold)?);
    }
    let images: Vec<_> =
        drawing.images.iter().map(|pixels| write_image(&mut pdf, next.bump(), pixels)).collect();
    let mut page = pdf.page(page);
    page.media_box(Rect::new(0.0, 0.0, width, height)).parent(pages).contents(content);
    let mut resources = page.resources();
    resources.fonts().pairs(fonts);
    let mut named = resources.x_objects();
    for (i, image) in images.into_iter().enumerate() {
        named.pair(Name(image_name(i).as_bytes()), image);
    }
    drop(named);
    drop(resources);
    drop(page);
    Ok(pdf.finish())
}

fn write_image(pdf: &mut Pdf, id: Ref, pixels: &Pixmap) -> Ref {
    let colours = pixels.pixels().iter().flat_map(|pixel| [pixel.red(), pixel.green(), pixel.blue()]);
    let data = compress_to_vec_zlib(&colours.collect::<Vec<_>>(), EFFORT);
    let mut image = pdf.image_xobject(id, &data);
    image.filter(Filter::FlateDecode);
    image.width(pixels.width() as i32).height(pixels.height() as i32).bits_per_component(8);
    image.color_space().device_rgb();
    id
}

fn image_name(i: usize) -> String {
    format!("I{i}")
}

/// Hundredths of a pixel suffice, as in SVG, and take less space.
fn px(length: impl Into<f64>) -> f32 {
    ((100.0 * length.into()).round() / 100.0) as f32
}

fn rgb(Rgb(r, g, b): Rgb) -> [f32; 3] {
    [r, g, b].map(|part| (f32::from(part) / 0.0255).round() / 1e4)
}

/// The content of the page, in CSS pixels to the right and down, with the images and fonts that it uses.
struct PdfDrawing<'a> {
    content: Content,
    images: Vec<&'a Pixmap>,
    fonts: [PdfFont; 2],
}

impl<'a> PdfDrawing<'a> {
    fn shape(&mut self, shape: &'a Shape) {
        if let Some([r, g, b]) = shape.fill.map(rgb) {
            self.content.set_fill_rgb(r, g, b);
        }
        match &shape.kind {
            ShapeKind::Text(at, text) => {
                self.text(text, |left, drop| [1.0, 0.0, 0.0, -1.0, px(at.x + left), px(at.y + drop)]);
            }
            ShapeKind::TextUpwards(at, text) => {
                self.text(text, |left, drop| [0.0, -1.0, -1.0, 0.0, px(at.x + drop), px(at.y - left)]);
            }
            ShapeKind::Image(area, pixels) => {
                let [x, y, width, height] = [area.left, area.bottom(), area.width, area.height].map(px);
                self.content.save_state().transform([width, 0.0, 0.0, -height, x, y]);
                self.content.x_object(Name(image_name(self.images.len()).as_bytes())).restore_state();
                self.images.push(pixels);
            }
            _ => self.path(shape),
        }
    }

    fn path(&mut self, shape: &Shape) {
        let Some(outline) = outline(shape) else { return };
        if let Some(stroke) = shape.visible_stroke() {
            self.pen(stroke);
        }
        let content = &mut self.content;
        let mut from = Point::zero();
        for segment in outline.segments() {
            match segment {
                PathSegment::MoveTo(to) => content.move_to(px(to.x), px(to.y)),
                PathSegment::LineTo(to) => content.line_to(px(to.x), px(to.y)),
                PathSegment::QuadTo(by, to) => {
                    let control =
                        |end: Point| [end.x + 2.0 * by.x, end.y + 2.0 * by.y].map(|sum| px(sum / 3.0));
                    let ([x1, y1], [x2, y2]) = (control(from), control(to));
                    content.cubic_to(x1, y1, x2, y2, px(to.x), px(to.y))
                }
                PathSegment::CubicTo(a, b, to) => {
                    content.cubic_to(px(a.x), px(a.y), px(b.x), px(b.y), px(to.x), px(to.y))
                }
                PathSegment::Close => content.close_path(),
            };
            if let PathSegment::MoveTo(to) | PathSegment::LineTo(to) | PathSegment::QuadTo(_, to) = segment {
                from = to;
            }
        }
        match (shape.fill, shape.visible_stroke()) {
            (Some(_), Some(_)) => content.fill_nonzero_and_stroke(),
            (Some(_), None) => content.fill_nonzero(),
            (None, Some(_)) => content.stroke(),
            (None, None) => content.end_path(),
        };
    }

    fn pen(&mut self, Stroke { colour, width, style }: Stroke) {
        let [r, g, b] = rgb(colour);
        let (cap, dashes): (_, &[u8]) = match style {
            Style::Solid => (LineCapStyle::ButtCap, &[]),
            Style::Dashed(dashes) => (LineCapStyle::ButtCap, dashes),
            Style::Dots => (LineCapStyle::RoundCap, &[]),
        };
        self.content.set_stroke_rgb(r, g, b).set_line_width(px(width)).set_line_cap(cap);
        self.content.set_line_join(LineJoinStyle::RoundJoin);
        self.content.set_dash_pattern(dashes.iter().copied().map(f32::from), 0.0);
    }

    /// Each level of the text at its place, with its kerning.
    fn text(&mut self, text: &Text, matrix: impl Fn(f64, f64) -> [f32; 6]) {
        let (font, (key, _)) = (&mut self.fonts[usize::from(text.bold)], FONTS[usize::from(text.bold)]);
        self.content.begin_text();
        for part in text.glyphs().chunk_by(|a, b| a.drop == b.drop) {
            let Glyph { left, drop, size, .. } = part[0];
            self.content.set_font(key, px(size)).set_text_matrix(matrix(left, drop));
            let mut shown = self.content.show_positioned();
            let mut items = shown.items();
            let mut end = left;
            for glyph in part {
                if glyph.left != end {
                    items.adjust((1000.0 * (end - glyph.left) / size).round() as f32);
                }
                items.show(Str(&font.code(glyph).to_be_bytes()));
                end = glyph.left + glyph.advance;
            }
        }
        self.content.end_text();
    }
}

/// The glyphs of a font that the page uses.
#[derive(Default)]
struct PdfFont {
    subset: GlyphRemapper,
    /// The glyphs of the codes from 1 on, with the characters that they are for.
    glyphs: Vec<(GlyphId, char)>,
}

impl PdfFont {
    fn code(&mut self, glyph: &Glyph) -> u16 {
        let code = self.subset.remap(glyph.id.0);
        if usize::from(code) > self.glyphs.len() {
            self.glyphs.push((glyph.id, glyph.character));
        }
        code
    }

    fn write(&self, pdf: &mut Pdf, next: &mut Ref, bold: bool) -> anyhow::Result<(Name<'static>, Ref)> {
        let (face, (key, name)) = (face(bold), FONTS[usize::from(bold)]);
        let [id, descendant, descriptor, unicode, file] = [(); 5].map(|()| next.bump());
        let data = subsetter::subset(face.raw_face().data, 0, &self.subset).context("subset of a font")?;
        pdf.stream(file, &compress_to_vec_zlib(&data, EFFORT)).filter(Filter::FlateDecode);

        let mut characters = UnicodeCmap::new(Name(b"Characters"), IDENTITY);
        for (code, (_, character)) in (1_u16..).zip(&self.glyphs) {
            characters.pair(code, *character);
        }
        pdf.cmap(unicode, &compress_to_vec_zlib(&characters.finish(), EFFORT)).filter(Filter::FlateDecode);

        let name = format!("{}+{}", self.tag(), name);
        let name = Name(name.as_bytes());
        let mut font = pdf.type0_font(id);
        font.base_font(name).encoding_predefined(Name(b"Identity-H"));
        font.descendant_font(descendant).to_unicode(unicode);
        drop(font);

        let thousandths = |units: i32| 1000.0 * units as f32 / f32::from(face.units_per_em());
        let ids = [GlyphId(0)].into_iter().chain(self.glyphs.iter().map(|(id, _)| *id));
        let mut font = pdf.cid_font(descendant);
        font.subtype(CidFontType::Type2).base_font(name).system_info(IDENTITY).font_descriptor(descriptor);
        font.cid_to_gid_map_predefined(Name(b"Identity"));
        let advance = |id| face.glyph_hor_advance(id).map_or(0, i32::from);
        font.widths().consecutive(0, ids.map(|id| thousandths(advance(id))));
        drop(font);

        let bounds = face.global_bounding_box();
        let [x1, y1, x2, y2] =
            [bounds.x_min, bounds.y_min, bounds.x_max, bounds.y_max].map(|unit| thousandths(unit.into()));
        let mut about = pdf.font_descriptor(descriptor);
        about.name(name).flags(FontFlags::SYMBOLIC).bbox(Rect::new(x1, y1, x2, y2)).italic_angle(0.0);
        about.ascent(thousandths(face.ascender().into())).descent(thousandths(face.descender().into()));
        about.cap_height(thousandths(face.capital_height().map_or(0, i32::from)));
        about.stem_v(if bold { 170.0 } else { 95.0 }).font_file2(file);
        Ok((key, id))
    }

    /// Six letters that differ between subsets, as PDF wants.
    fn tag(&self) -> String {
        let mix = |sum: u64, id: u16| sum.wrapping_mul(0x0100_0000_01b3) ^ u64::from(id);
        let sum = self.subset.remapped_gids().fold(0, mix);
        (0..6).map(|i| char::from(b'A' + (sum / 26_u64.pow(i) % 26) as u8)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::canvas::Canvas;
    use crate::drawing::shape::at;

    /// The decompressed streams of a PDF.
    fn streams(pdf: &[u8]) -> String {
        let after = |bytes: &[u8], word: &[u8]| bytes.windows(word.len()).position(|part| part == word);
        let (mut rest, mut content) = (pdf, Vec::new());
        while let Some(start) = after(rest, b"stream\n") {
            rest = &rest[start + b"stream\n".len()..];
            let end = after(rest, b"endstream").unwrap();
            content.extend(miniz_oxide::inflate::decompress_to_vec_zlib(&rest[..end]).unwrap());
            rest = &rest[end + b"endstream".len()..];
        }
        String::from_utf8_lossy(&content).into_owned()
    }

    /// Codes of glyphs have their characters, each font is embedded once, and only with the glyphs that are used.
    #[test]
    fn text_can_be_selected_in_pdf() {
        let mut canvas = Canvas::new(120.0, 40.0);
        canvas.text(at(4.0, 20.0), &Text::new("σ_t −3", 12.0));
        canvas.text_upwards(at(110.0, 30.0), &Text::new("σ", 12.0));
        canvas.text(at(60.0, 20.0), &Text::new("AV", 12.0).bold());
        let pdf = canvas.finish().pdf(None).unwrap();
        let content = streams(&pdf);
        for pair in ["<0001> <03C3>", "<0002> <0074>", "<0004> <2212>", "<0001> <0041>", "<0002> <0056>"] {
            assert!(content.contains(pair), "{pair} in {content}");
        }
        assert_eq!(content.matches("beginbfchar").count(), 2);
        assert!(pdf.len() < 20_000, "{} bytes", pdf.len());
    }

    #[test]
    fn subsets_of_a_font_differ_by_name() {
        let mut font = PdfFont::default();
        let mut name = |content: &str| {
            for glyph in Text::new(content, 9.0).glyphs() {
                font.code(&glyph);
            }
            font.tag()
        };
        let names = [name("a"), name("a"), name("ab")];
        assert!(names[0] == names[1] && names[1] != names[2], "{names:?}");
        assert!(names.iter().all(|name| name.len() == 6 && name.bytes().all(|b| b.is_ascii_uppercase())));
    }
}
