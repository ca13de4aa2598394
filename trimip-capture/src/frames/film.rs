//! Properties of a film as ffprobe reports them: its displayed size, its frames, its encoding of brightness.

use serde::Deserialize;
use std::path::Path;
use trimip::{
    Error, Result,
    formatting::{count, duration},
};

/// Longest side of the frames that are measured, pixels: half of that of a phone's film. A blur of two pixels is still visible at this
/// size.
const MEASURED: u32 = 960;

/// Relative difference between the mean and the nominal frame rate above which the rate counts as variable.
const VARIABLE: f64 = 0.01;

/// Dynamic range of a film, which its transfer function determines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Range {
    /// Standard dynamic range.
    Standard,
    /// Hybrid log-gamma (HLG), which phones record.
    Hlg,
    /// Perceptual quantiser (PQ) of HDR10 and Dolby Vision.
    Pq,
}

/// A film.
#[derive(Debug, PartialEq)]
pub struct Film {
    /// Displayed width and height, pixels.
    size: [u32; 2],
    /// Rotation that a player applies when showing the film, degrees.
    turned: i32,
    /// Duration, seconds; 0 if the file does not state it.
    seconds: f64,
    /// Mean frame rate, per second.
    pub rate: f64,
    /// Number of frames, stated or estimated; 0 if unknown.
    pub frames: u64,
    is_variable: bool,
    is_interlaced: bool,
    bits: u32,
    range: Range,
    codec: String,
}

#[derive(Deserialize)]
struct Probed {
    #[serde(default)]
    streams: Vec<Stream>,
    format: Option<Format>,
}

#[derive(Deserialize)]
struct Format {
    duration: Option<String>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Stream {
    codec_name: String,
    width: u32,
    height: u32,
    pix_fmt: String,
    color_transfer: String,
    field_order: String,
    r_frame_rate: String,
    avg_frame_rate: String,
    duration: Option<String>,
    nb_frames: Option<String>,
    tags: Tags,
    side_data_list: Vec<SideData>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Tags {
    rotate: Option<String>,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct SideData {
    rotation: Option<f64>,
}

impl Film {
    /// Reads the properties of a film with ffprobe.
    ///
    /// # Errors
    /// Of kind `Input`, when ffprobe cannot read the film.
    pub fn probe(ffprobe: &Path, film: &Path) -> Result<Self> {
        let wrong = |what: String| {
            Error::input(
                film.display(),
                what,
                "check that a player shows it, then convert it to MP4 or copy it again",
            )
        };
        let output = std::process::Command::new(ffprobe)
            .args(["-v", "error", "-select_streams", "v:0", "-show_streams", "-show_format", "-of", "json"])
            .arg(film)
            .stdin(std::process::Stdio::null())
            .output()
            .map_err(|error| Error::device(format!("ffprobe cannot be started: {error}")))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            let last = said
                .lines()
                .rfind(|line| !line.trim().is_empty())
                .unwrap_or("it printed nothing")
                .to_string();
            return Err(wrong(format!("ffprobe cannot read it: {last}")));
        }
        Self::of_json(&output.stdout).ok_or_else(|| wrong("has no video stream".into()))
    }

    fn of_json(bytes: &[u8]) -> Option<Self> {
        let probed: Probed = serde_json::from_slice(bytes).ok()?;
        let stream =
            probed.streams.into_iter().next().filter(|stream| stream.width > 0 && stream.height > 0)?;
        let number = |text: Option<String>| text.and_then(|text| text.parse::<f64>().ok());
        let seconds = number(stream.duration).or(number(probed.format.and_then(|format| format.duration)));
        let seconds = seconds.filter(|seconds| seconds.is_finite() && *seconds > 0.0).unwrap_or(0.0);
        let (mean, nominal) = (rate(&stream.avg_frame_rate), rate(&stream.r_frame_rate));
        let stated = stream.nb_frames.and_then(|text| text.parse().ok()).filter(|frames| *frames > 0);
        let known = mean.or(nominal).unwrap_or(30.0);
        let beside = stream.side_data_list.iter().find_map(|data| data.rotation);
        let turned = beside.map(|angle| -angle).or(number(stream.tags.rotate)).unwrap_or(0.0);
        let turned = (turned.round() as i32).rem_euclid(360);
        let size =
            if turned % 180 == 90 { [stream.height, stream.width] } else { [stream.width, stream.height] };
        Some(Self {
            size,
            turned,
            seconds,
            rate: known,
            frames: stated.unwrap_or((seconds * known).round() as u64),
            is_variable: mean
                .zip(nominal)
                .is_some_and(|(mean, nominal)| (mean / nominal - 1.0).abs() > VARIABLE),
            is_interlaced: ["tt", "bb", "tb", "bt"].contains(&stream.field_order.as_str()),
            bits: bits(&stream.pix_fmt),
            range: match stream.color_transfer.as_str() {
                "arib-std-b67" => Range::Hlg,
                "smpte2084" => Range::Pq,
                _ => Range::Standard,
            },
            codec: stream.codec_name,
        })
    }

    /// Describes the film in words. `maps_tones` is true if this ffmpeg can tone-map HDR.
    pub fn lines(&self, maps_tones: bool) -> Vec<String> {
        let [width, height] = self.size;
        let length = match self.seconds {
            0.0 => "unknown length".into(),
            seconds => duration(seconds),
        };
        let mut line = format!(
            "film: {width}×{height}, {length}, {} at {:.4} a second, {}",
            count(self.frames, "frame"),
            self.rate,
            self.codec
        );
        let mut more = Vec::new();
        if self.turned != 0 {
            more.push(format!("turned by {}° according to its metadata", self.turned));
        }
        if self.is_variable {
            more.push("a variable rate: each frame has its own time".into());
        }
        if self.is_interlaced {
            more.push("interlaced: the frames are deinterlaced".into());
        }
        match self.range {
            Range::Standard if self.bits > 8 => more.push(format!("{} bits, of which 8 are kept", self.bits)),
            Range::Standard => {}
            range => {
                let name = if range == Range::Hlg { "HLG" } else { "PQ" };
                more.push(match maps_tones {
                    true => format!("HDR ({name}), mapped to the range of photographs"),
                    false => {
                        format!("HDR ({name}), whose colours stay pale: this ffmpeg lacks the filter zscale")
                    }
                });
            }
        }
        more.iter().for_each(|more| line += &format!("; {more}"));
        vec![line]
    }

    /// Returns the size at which frames are measured: even numbers of pixels.
    pub fn measured_size(&self) -> [u32; 2] {
        let longest = self.size[0].max(self.size[1]);
        let scale = f64::from(MEASURED.min(longest)) / f64::from(longest);
        self.size.map(|side| ((f64::from(side) * scale / 2.0).round() as u32 * 2).max(16))
    }

    /// Returns the filter that deinterlaces, with a trailing comma; empty for progressive films.
    pub fn deinterlace(&self) -> &'static str {
        if self.is_interlaced { "yadif," } else { "" }
    }

    /// Returns the filters that tone-map HDR to the range of photographs, with a leading comma; empty if nothing has to be mapped.
    pub fn tones(&self, maps_tones: bool) -> &'static str {
        match self.range {
            Range::Standard => "",
            _ if !maps_tones => "",
            // Paper white is 100 to 203 cd/m² in both HLG and PQ; Hable's curve keeps the mid-tones and compresses highlights.
            _ => {
                ",zscale=t=linear:npl=203,format=gbrpf32le,zscale=p=bt709,tonemap=hable:desat=0,\
                 zscale=t=bt709:m=bt709:r=full,format=yuv420p"
            }
        }
    }
}

/// Parses a rate such as `30000/1001`.
fn rate(text: &str) -> Option<f64> {
    let (over, under) = text.split_once('/').unwrap_or((text, "1"));
    let rate = over.parse::<f64>().ok()? / under.parse::<f64>().ok()?;
    (rate.is_finite() && rate > 0.0).then_some(rate)
}

/// Returns the number of bits per channel of a pixel format.
fn bits(format: &str) -> u32 {
    let deep = [("p10", 10), ("p12", 12), ("p16", 16), ("10le", 10), ("12le", 12)];
    deep.iter().find(|(part, _)| format.contains(part)).map_or(8, |(_, bits)| *bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn film(stream: &str) -> Film {
        let json = format!("{{\"streams\":[{{{stream}}}],\"format\":{{\"duration\":\"12.0\"}}}}");
        Film::of_json(json.as_bytes()).unwrap()
    }

    #[test]
    fn a_phone_s_film_is_turned_deep_and_of_variable_rate() {
        let phone = film(
            "\"codec_name\":\"hevc\",\"width\":3840,\"height\":2160,\"pix_fmt\":\"yuv420p10le\",\"color_transfer\":\"arib-std-b67\",\
             \"r_frame_rate\":\"60/1\",\"avg_frame_rate\":\"2997/100\",\"nb_frames\":\"358\",\"field_order\":\"progressive\",\
             \"side_data_list\":[{\"side_data_type\":\"Display Matrix\",\"rotation\":-90}]",
        );
        assert_eq!((phone.size, phone.turned, phone.frames, phone.bits), ([2160, 3840], 90, 358, 10));
        assert_eq!(phone.measured_size(), [540, 960]);
        let line = phone.lines(true).concat();
        for part in ["2160×3840", "turned by 90°", "variable rate", "HDR (HLG), mapped", "358 frames", "12 s"]
        {
            assert!(line.contains(part), "{part}: {line}");
        }
        assert!(phone.lines(false).concat().contains("zscale") && phone.tones(false).is_empty());
        assert!(phone.tones(true).contains("tonemap"));
    }

    #[test]
    fn an_old_film_states_little() {
        let old = film(
            "\"codec_name\":\"h264\",\"width\":720,\"height\":576,\"field_order\":\"tt\",\"avg_frame_rate\":\"25/1\",\"tags\":{\"rotate\":\"180\"}",
        );
        assert_eq!((old.size, old.turned, old.frames, old.rate), ([720, 576], 180, 300, 25.0));
        assert!(old.deinterlace() == "yadif," && old.tones(true).is_empty());
        assert_eq!(old.measured_size(), [720, 576]);
        assert_eq!(Film::of_json(b"{\"streams\":[]}"), None);
        assert_eq!((rate("0/0"), rate("30000/1001").map(f64::round)), (None, Some(30.0)));
    }
}
