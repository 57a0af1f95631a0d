//! Which renderer draws, as the programs of this package are told on their
//! command lines.

use sim::{GlDevice, Renderer};

/// Reads `software`, `gl` or `gl:N`, N being a device of the driver's list.
///
/// # Errors
/// In words, where it is none of these.
pub fn parse(text: &str) -> Result<Renderer, String> {
    let wrong = || format!("`{text}` is no renderer: software, gl, or gl:N for the N-th device");
    match text {
        "software" => Ok(Renderer::Software),
        "gl" => Ok(Renderer::Gl(GlDevice::Auto)),
        _ => {
            let index = text.strip_prefix("gl:").ok_or_else(wrong)?;
            let index = index.parse().map_err(|_| wrong())?;
            Ok(Renderer::Gl(GlDevice::Index(index)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_renderer_is_named_in_three_ways() {
        assert_eq!(parse("software"), Ok(Renderer::Software));
        assert_eq!(parse("gl"), Ok(Renderer::Gl(GlDevice::Auto)));
        assert_eq!(parse("gl:1"), Ok(Renderer::Gl(GlDevice::Index(1))));
        for wrong in ["", "opengl", "gl:", "gl:x", "Software"] {
            assert!(parse(wrong).unwrap_err().contains("is no renderer"));
        }
    }
}
