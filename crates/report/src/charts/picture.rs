//! Pictures as files: SVG with an embedded font, PNG, PDF.
//!
//! Input: an SVG text of this crate's charts. Output: the bytes of a file that looks the same on
//! every machine. SVG keeps text and embeds the font (Roboto, `assets/roboto`, Apache License 2.0).
//! PNG and PDF have outlines of that font in place of text, so they need no installed font. PNG and
//! PDF need the feature `pictures`.
//!
//! Errors: a message when a picture cannot be drawn, or when this build cannot draw it.

use std::path::Path;

/// File format of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PictureFormat {
    /// Scalable Vector Graphics.
    Svg,
    /// Portable Network Graphics.
    Png,
    /// Portable Document Format.
    Pdf,
}

/// Endings of the names of the pictures that this build draws.
pub const ENDINGS: &str = if cfg!(feature = "pictures") {
    ".svg, .png or .pdf"
} else {
    ".svg (.png and .pdf need an nsim built with --features pictures)"
};

/// Name of a picture's file in help texts.
pub const FILE: &str = if cfg!(feature = "pictures") { "FILE.svg|png|pdf" } else { "FILE.svg" };

impl PictureFormat {
    /// The format of a file name's ending; none for another ending.
    pub fn from_name(path: &Path) -> Option<Self> {
        match path.extension()?.to_string_lossy().to_ascii_lowercase().as_str() {
            "svg" => Some(PictureFormat::Svg),
            "png" => Some(PictureFormat::Png),
            "pdf" => Some(PictureFormat::Pdf),
            _ => None,
        }
    }

    /// Checks that this build can draw a picture in this format.
    ///
    /// # Errors
    /// A message with a name that works, and with the feature to build.
    pub fn check(self, path: &Path) -> Result<(), String> {
        match self {
            PictureFormat::Svg => Ok(()),
            _ if cfg!(feature = "pictures") => Ok(()),
            _ => Err(format!(
                "this nsim was built without the feature 'pictures', which draws PNG and PDF: name it {}, or build nsim \
                 with --features pictures",
                path.with_extension("svg").display()
            )),
        }
    }

    /// The file of a picture.
    ///
    /// # Errors
    /// A message when it cannot be drawn; the charts of this crate can be.
    pub fn bytes(self, svg: &str) -> Result<Vec<u8>, String> {
        match self {
            PictureFormat::Svg => Ok(with_font(svg).into_bytes()),
            #[cfg(feature = "pictures")]
            PictureFormat::Png => drawn::png(svg),
            #[cfg(feature = "pictures")]
            PictureFormat::Pdf => drawn::pdf(svg),
            #[cfg(not(feature = "pictures"))]
            _ => Err("PNG and PDF are drawn by the feature 'pictures' alone".to_string()),
        }
    }
}

/// Latin and Greek of the font, as the base64 digits of a WOFF2 file.
const FONT_DIGITS: &str =
    include_str!(concat!(env!("CARGO_MANIFEST_DIR"), env!("ASSETS"), "/roboto/roboto-latin.woff2.base64"));

/// A picture with an embedded font.
pub fn with_font(svg: &str) -> String {
    let Some((head, rest)) = svg.split_once('>') else { return svg.to_string() };
    let head = head.replace("font-family=\"sans-serif\"", "font-family=\"Roboto, Arial, sans-serif\"");
    format!(
        "{head}>\n<style>@font-face{{font-family:Roboto;src:url(data:font/woff2;base64,{})}}</style>{rest}",
        FONT_DIGITS.trim()
    )
}

#[cfg(feature = "pictures")]
mod drawn {
    use std::fmt::Write as _;

    use resvg::tiny_skia::{Pixmap, Transform};
    use resvg::usvg::roxmltree::{Document, Node};
    use resvg::usvg::{Options, Tree};
    use ttf_parser::{Face, GlyphId, OutlineBuilder};

    const FONT: &[u8] =
        include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), env!("ASSETS"), "/roboto/roboto-subset.ttf"));
    /// Pixels of a picture for each of its units, fewer where there were more than [`MOST_PIXELS`].
    const SCALE: f32 = 3.0;
    const MOST_PIXELS: f32 = 6e7;

    pub fn png(svg: &str) -> Result<Vec<u8>, String> {
        let tree = tree(svg)?;
        let (width, height) = (tree.size().width(), tree.size().height());
        let scale = SCALE.min((MOST_PIXELS / (width * height)).sqrt());
        let pixels = |units: f32| (units * scale).ceil().max(1.0) as u32;
        let mut picture = Pixmap::new(pixels(width), pixels(height)).ok_or("the picture has no size")?;
        resvg::render(&tree, Transform::from_scale(scale, scale), &mut picture.as_mut());
        picture.encode_png().map_err(|error| error.to_string())
    }

    pub fn pdf(svg: &str) -> Result<Vec<u8>, String> {
        let (conversion, page) = (svg2pdf::ConversionOptions::default(), svg2pdf::PageOptions::default());
        svg2pdf::to_pdf(&tree(svg)?, conversion, page).map_err(|error| error.to_string())
    }

    fn tree(svg: &str) -> Result<Tree, String> {
        Tree::from_str(&outlined(svg)?, &Options::default()).map_err(|error| error.to_string())
    }

    /// The picture with outlines in place of text.
    pub fn outlined(svg: &str) -> Result<String, String> {
        let document = Document::parse(svg).map_err(|error| error.to_string())?;
        let face = Face::parse(FONT, 0).map_err(|error| error.to_string())?;
        let (mut out, mut end) = (String::with_capacity(2 * svg.len()), 0);
        for node in document.descendants().filter(|node| node.has_tag_name("text")) {
            let range = node.range();
            out += &svg[end..range.start];
            out += &outline(&face, node);
            end = range.end;
        }
        Ok(out + &svg[end..])
    }

    fn inherited<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
        node.ancestors().find_map(|node| node.attribute(name))
    }

    /// Path of the glyphs of a line of text, with scale and position of the next glyph.
    struct Line {
        path: String,
        scale: f64,
        x: f64,
        y: f64,
    }

    impl Line {
        fn point(&mut self, command: char, points: &[(f32, f32)]) {
            self.path.push(command);
            for &(x, y) in points {
                let (x, y) = (self.x + f64::from(x) * self.scale, self.y - f64::from(y) * self.scale);
                // Writing to a String does not fail.
                let _ = write!(self.path, "{x:.2} {y:.2} ");
            }
        }
    }

    impl OutlineBuilder for Line {
        fn move_to(&mut self, x: f32, y: f32) {
            self.point('M', &[(x, y)]);
        }
        fn line_to(&mut self, x: f32, y: f32) {
            self.point('L', &[(x, y)]);
        }
        fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
            self.point('Q', &[(x1, y1), (x, y)]);
        }
        fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
            self.point('C', &[(x1, y1), (x2, y2), (x, y)]);
        }
        fn close(&mut self) {
            self.path.push('Z');
        }
    }

    fn outline(face: &Face<'_>, node: Node<'_, '_>) -> String {
        let number = |name: &str| inherited(node, name).and_then(|text| text.parse::<f64>().ok());
        let own = |name: &str| node.attribute(name).and_then(|text| text.parse::<f64>().ok()).unwrap_or(0.0);
        let scale = number("font-size").unwrap_or(12.0) / f64::from(face.units_per_em());
        let words: String = node.descendants().filter(Node::is_text).filter_map(|node| node.text()).collect();
        let glyphs: Vec<GlyphId> = words.chars().map(|c| face.glyph_index(c).unwrap_or(GlyphId(0))).collect();
        let advance = |&glyph: &GlyphId| f64::from(face.glyph_hor_advance(glyph).unwrap_or(0)) * scale;
        let width: f64 = glyphs.iter().map(advance).sum();
        let before = match inherited(node, "text-anchor") {
            Some("middle") => width / 2.0,
            Some("end") => width,
            _ => 0.0,
        };
        let mut line = Line { path: String::new(), scale, x: own("x") - before, y: own("y") };
        for glyph in &glyphs {
            face.outline_glyph(*glyph, &mut line);
            line.x += advance(glyph);
        }
        let mut out = String::from("<path");
        for name in ["transform", "fill"] {
            if let Some(value) = node.attribute(name) {
                let _ = write!(out, " {name}=\"{value}\"");
            }
        }
        let _ = write!(out, " d=\"{}\"/>", line.path);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SVG: &str = "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 40 20\" font-family=\"sans-serif\" \
                       font-size=\"10\">\n<rect width=\"40\" height=\"20\" fill=\"white\"/>\n<text x=\"20\" y=\"15\" \
                       text-anchor=\"middle\" fill=\"#f00\">a &amp; b</text>\n</svg>\n";

    #[test]
    fn a_name_says_the_kind() {
        let kind = |name: &str| PictureFormat::from_name(Path::new(name));
        assert_eq!((kind("a.svg"), kind("b/a.PNG")), (Some(PictureFormat::Svg), Some(PictureFormat::Png)));
        assert_eq!((kind("a.pdf"), kind("a.gif"), kind("svg")), (Some(PictureFormat::Pdf), None, None));
    }

    #[test]
    fn an_svg_holds_its_font_and_keeps_its_words() {
        let text = String::from_utf8(PictureFormat::Svg.bytes(SVG).unwrap()).unwrap();
        assert!(text.contains("@font-face") && text.contains(">a &amp; b</text>") && text.ends_with("</svg>\n"));
        assert!(text.contains("font-family=\"Roboto, Arial, sans-serif\"") && !text.contains("http://fonts"));
    }

    #[cfg(feature = "pictures")]
    #[test]
    fn words_are_drawn_where_they_stand() {
        let outlined = drawn::outlined(SVG).unwrap();
        assert!(!outlined.contains("<text") && outlined.contains("<path fill=\"#f00\" d=\"M"), "{outlined}");
        let png = PictureFormat::Png.bytes(SVG).unwrap();
        let picture = resvg::tiny_skia::Pixmap::decode_png(&png).unwrap();
        assert_eq!((picture.width(), picture.height()), (120, 60));
        let reds = (0..60).flat_map(|y| (0..120).map(move |x| (x, y)));
        let reds: Vec<(u32, u32)> = reds.filter(|&(x, y)| picture.pixel(x, y).unwrap().green() < 80).collect();
        // The words are some 20 units wide around unit 20 and stand on unit 15.
        let (left, right) = (reds.iter().map(|p| p.0).min().unwrap(), reds.iter().map(|p| p.0).max().unwrap());
        assert!((25..50).contains(&left) && (70..95).contains(&right) && (left + right).abs_diff(120) < 8);
        assert!(reds.iter().all(|p| (18..48).contains(&p.1)), "{reds:?}");
        let pdf = PictureFormat::Pdf.bytes(SVG).unwrap();
        assert!(pdf.starts_with(b"%PDF-1") && pdf.len() > 500);
        assert_eq!((pdf, png), (PictureFormat::Pdf.bytes(SVG).unwrap(), PictureFormat::Png.bytes(SVG).unwrap()));
    }
}
