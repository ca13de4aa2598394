//! Exports of Metashape, RealityCapture, OpenSfM and LLFF's script.

use super::Input;
use crate::common::{
    ring::{cameras, pinhole, vision},
    save_image, write,
};
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::{fs, path::Path};
use trimip_core::{Camera, Intrinsics, Lens, geometry::projections::Model};

pub const INPUTS: &[(&str, Input)] = &[
    ("metashape_labels_of_files", labels_of_files),
    ("metashape_spherical", spherical),
    ("metashape_rig", rig),
    ("metashape_several_sensors", several_sensors),
    ("metashape_groups", groups),
    ("metashape_unplaced", unplaced),
    ("metashape_sensor_without_use", sensor_without_use),
    ("metashape_tangential", tangential),
    ("metashape_georeferenced", georeferenced),
    ("metashape_upright", upright),
    ("realitycapture_needed_columns", needed_columns),
    ("realitycapture_principal_point", principal_point),
    ("realitycapture_more_cameras", more_cameras),
    ("realitycapture_omega_phi_kappa", omega_phi_kappa),
    ("opensfm_images_in_folder", images_in_folder),
    ("opensfm_in_parts", in_parts),
    ("opensfm_of_macos", of_macos),
    ("llff_of_macos", llff_of_macos),
    ("llff_without_all_poses", llff_without_all_poses),
];

const PINHOLE: &str = "<f>52.5</f><cx>-1</cx><cy>1</cy><b1>-1</b1>";

fn save_images(root: &Path) {
    (0..9).for_each(|index| save_image(&root.join(format!("{index}.png")), 60, 40));
}

fn sensor(id: u32, kind: &str, size: [u32; 2], terms: Option<&str>) -> String {
    let resolution = format!("<resolution width=\"{}\" height=\"{}\"/>", size[0], size[1]);
    let calibration = terms.map(|terms| {
        format!("<calibration type=\"{kind}\" class=\"adjusted\">{resolution}{terms}</calibration>")
    });
    format!(
        "<sensor id=\"{id}\" label=\"s\" type=\"{kind}\">{resolution}{}</sensor>",
        calibration.unwrap_or_default()
    )
}

/// Returns a camera with its pose, or without one.
fn camera(label: &str, sensor: u32, pose: Option<&Camera>) -> String {
    let transform = |camera: &Camera| {
        let axes = camera.rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let row =
            |i: usize| format!("{} {} {} {} ", axes.row(i).x, axes.row(i).y, axes.row(i).z, camera.origin[i]);
        format!("<transform>{}{}{}0 0 0 1</transform>", row(0), row(1), row(2))
    };
    let pose = pose.map(transform).unwrap_or_default();
    format!("<camera id=\"0\" sensor_id=\"{sensor}\" label=\"{label}\" enabled=\"true\">{pose}</camera>")
}

fn metashape(root: &Path, sensors: &str, cameras: &str) {
    let document = format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"2.0.0\"><chunk label=\"Chunk 1\" enabled=\"true\">\
         <sensors next_id=\"9\">{sensors}</sensors><cameras next_id=\"99\">{cameras}</cameras></chunk></document>"
    );
    fs::write(root.join("cameras.xml"), document).unwrap();
}

/// Writes the ring with one sensor; labels are the numbers of the photographs.
fn ring(root: &Path, around: [&str; 2]) -> Vec<Camera> {
    save_images(root);
    let all = cameras(pinhole());
    let listed: String =
        all.iter().enumerate().map(|(index, own)| camera(&index.to_string(), 0, Some(own))).collect();
    let [before, after] = around;
    metashape(root, &sensor(0, "frame", [60, 40], Some(PINHOLE)), &format!("{before}{listed}{after}"));
    all
}

/// Writes labels with the endings that photographs had before they were converted.
fn labels_of_files(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    let label = |index: usize| format!("IMG_{index}.JPG");
    (0..9).for_each(|index| save_image(&root.join(format!("images/IMG_{index}.png")), 60, 40));
    let listed: String =
        all.iter().enumerate().map(|(index, own)| camera(&label(index), 0, Some(own))).collect();
    metashape(root, &sensor(0, "frame", [60, 40], Some(PINHOLE)), &listed);
    all
}

/// Writes panoramas, which have no calibration.
fn spherical(root: &Path) -> Vec<Camera> {
    (0..9).for_each(|index| save_image(&root.join(format!("{index}.png")), 64, 32));
    let lens = Lens::of(Model::Equirectangular);
    let all = cameras(Intrinsics { width: 64, height: 32, fx: 32.0, fy: 32.0, cx: 32.0, cy: 16.0, lens });
    let listed: String =
        all.iter().enumerate().map(|(index, own)| camera(&index.to_string(), 0, Some(own))).collect();
    metashape(root, &sensor(0, "spherical", [64, 32], None), &listed);
    all
}

/// Writes a rig in which only the first camera has poses.
fn rig(root: &Path) -> Vec<Camera> {
    let others: String = (0..9).map(|index| camera(&format!("slave_{index}"), 0, None)).collect();
    ring(root, ["", &others])
}

fn several_sensors(root: &Path) -> Vec<Camera> {
    save_images(root);
    let mut all = cameras(pinhole());
    all.iter_mut().skip(5).for_each(|camera| (camera.intrinsics.fx, camera.intrinsics.fy) = (44.0, 44.0));
    (5..9).for_each(|index| (all[index].intrinsics.cx, all[index].intrinsics.cy) = (30.0, 20.0));
    let listed: String = (0..9)
        .map(|index| camera(&index.to_string(), if index < 5 { 0 } else { 4 }, Some(&all[index])))
        .collect();
    let sensors =
        sensor(0, "frame", [60, 40], Some(PINHOLE)) + &sensor(4, "frame", [60, 40], Some("<f>44</f>"));
    metashape(root, &sensors, &listed);
    all
}

fn groups(root: &Path) -> Vec<Camera> {
    ring(root, ["<group id=\"0\" label=\"walk\" type=\"folder\">", "</group>"])
}

fn unplaced(root: &Path) -> Vec<Camera> {
    ring(root, [&camera("blurred", 0, None), ""])
}

fn sensor_without_use(root: &Path) -> Vec<Camera> {
    let all = ring(root, ["", ""]);
    let path = root.join("cameras.xml");
    let text = fs::read_to_string(&path).unwrap();
    let bare = "<sensor id=\"7\" label=\"unknown\" type=\"frame\"/></sensors>";
    fs::write(path, text.replace("</sensors>", bare)).unwrap();
    all
}

/// Writes tangential coefficients: Metashape's p1 bends along x, OpenCV's along y.
fn tangential(root: &Path) -> Vec<Camera> {
    save_images(root);
    let lens = Lens::perspective([-0.1, 0.0, 0.0, 0.0], [-0.002, 0.001], [0.0; 3]);
    let all = cameras(Intrinsics { lens, ..pinhole() });
    let listed: String =
        all.iter().enumerate().map(|(index, own)| camera(&index.to_string(), 0, Some(own))).collect();
    let terms = format!("{PINHOLE}<k1>-0.1</k1><p1>0.001</p1><p2>-0.002</p2>");
    metashape(root, &sensor(0, "frame", [60, 40], Some(&terms)), &listed);
    all
}

/// Writes a chunk with a transform to the earth, which is not applied: cameras stay in the units of the chunk.
fn georeferenced(root: &Path) -> Vec<Camera> {
    let all = ring(root, ["", ""]);
    let path = root.join("cameras.xml");
    let transform = "<transform><rotation>0 1 0 -1 0 0 0 0 1</rotation><translation>4000000 500000 4900000</translation>\
                     <scale>12.5</scale></transform></chunk>";
    let text = fs::read_to_string(&path).unwrap();
    fs::write(path, text.replace("</chunk>", transform)).unwrap();
    all
}

/// Writes upright photographs of a sensor with a landscape format.
fn upright(root: &Path) -> Vec<Camera> {
    ring(root, ["", ""]);
    (0..9).for_each(|index| save_image(&root.join(format!("{index}.png")), 40, 60));
    Vec::new()
}

/// Returns position, heading, pitch and roll of a camera in RealityCapture, and its camera-to-world rotation.
fn placed(index: usize) -> ([f64; 6], DMat3) {
    let i = index as f64;
    let angles = [170.0 - 25.0 * i, 85.0 + i, -22.5 + 3.0 * i];
    let [(sz, cz), (sy, cy), (sx, cx)] = angles.map(|angle: f64| angle.to_radians().sin_cos());
    let rows = [
        [cx * cz + sx * sy * sz, -cx * sz + cz * sx * sy, -cy * sx],
        [-cy * sz, -cy * cz, -sy],
        [cx * sy * sz - cz * sx, cx * cz * sy + sx * sz, -cx * cy],
    ];
    let [heading, pitch, roll] = angles;
    ([40.0 + i, 130.0 - 2.0 * i, 6.5, heading, pitch, roll], DMat3::from_cols_array_2d(&rows))
}

/// Writes a CSV file with these columns after those of the pose, and returns its cameras.
fn realitycapture(root: &Path, columns: &str, values: &str, intrinsics: Intrinsics) -> Vec<Camera> {
    save_images(root);
    let mut text = format!("#name,x,y,alt,heading,pitch,roll,{columns}\n");
    let mut all = Vec::new();
    for index in 0..9 {
        let (numbers, to_world) = placed(index);
        text += &format!("{index}.png,{},{values}\n", numbers.map(|number| number.to_string()).join(","));
        let rotation = to_world * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        all.push(Camera { intrinsics, rotation, origin: DVec3::new(numbers[0], numbers[1], numbers[2]) });
    }
    fs::write(root.join("export.csv"), text).unwrap();
    all
}

fn needed_columns(root: &Path) -> Vec<Camera> {
    let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 30.0, cy: 20.0, ..pinhole() };
    realitycapture(root, "f", "24", intrinsics)
}

fn principal_point(root: &Path) -> Vec<Camera> {
    let lens = Lens::perspective([3e-3, 4e-3, -1.8e-3, 0.0], [0.0; 2], [0.0; 3]);
    let intrinsics = Intrinsics {
        fx: 40.0,
        fy: 40.0,
        cx: 30.0 - 60.0 * 9.5e-4,
        cy: 20.0 + 60.0 * 2e-3,
        lens,
        ..pinhole()
    };
    let values = "24,-9.5e-004,2e-003,3e-003,4e-003,-1.8e-003,0,0,0";
    realitycapture(root, "f,px,py,k1,k2,k3,k4,t1,t2", values, intrinsics)
}

/// Deletes photographs after the export.
fn more_cameras(root: &Path) -> Vec<Camera> {
    realitycapture(root, "f", "24", pinhole());
    [2, 3, 7].iter().for_each(|index| fs::remove_file(root.join(format!("{index}.png"))).unwrap());
    Vec::new()
}

fn omega_phi_kappa(root: &Path) -> Vec<Camera> {
    save_images(root);
    fs::write(root.join("export.csv"), "#name,x,y,alt,omega,phi,kappa\n0.png,1,2,3,4,5,6\n").unwrap();
    Vec::new()
}

fn opensfm(all: &[Camera]) -> Value {
    let shot = |(index, camera): (usize, &Camera)| {
        let (rotation, t) = vision(camera);
        let (axis, angle) = DQuat::from_mat3(&rotation).to_axis_angle();
        let shot =
            json!({ "rotation": (axis * angle).to_array(), "translation": t.to_array(), "camera": "v2 dji" });
        (format!("{index}.png"), shot)
    };
    let camera = json!({ "projection_type": "brown", "width": 60, "height": 40, "focal_x": 51.5 / 60.0,
        "focal_y": 52.5 / 60.0, "c_x": -1.0 / 60.0, "c_y": 1.0 / 60.0 });
    let shots: serde_json::Map<String, Value> = all.iter().enumerate().map(shot).collect();
    json!({ "cameras": { "v2 dji": camera }, "shots": shots, "points": {} })
}

fn images_in_folder(root: &Path) -> Vec<Camera> {
    let all = cameras(pinhole());
    (0..9).for_each(|index| save_image(&root.join(format!("images/{index}.png")), 60, 40));
    write(&root.join("reconstruction.json"), &json!([opensfm(&all)]));
    let list: String = (0..9).map(|index| format!("/home/someone/berlin/images/{index}.png\n")).collect();
    fs::write(root.join("image_list.txt"), list).unwrap();
    all
}

fn in_parts(root: &Path) -> Vec<Camera> {
    let all = images_in_folder(root);
    write(&root.join("reconstruction.json"), &json!([opensfm(&all[..3]), opensfm(&all), opensfm(&all[..2])]));
    all
}

/// Writes files that macOS puts next to others.
fn strays(folder: &Path, name: impl Fn(usize) -> String) {
    (0..9).for_each(|index| fs::write(folder.join(format!("._{}", name(index))), b"\0\x05\x16\x07").unwrap());
    fs::write(folder.join(".DS_Store"), b"\0\0\0\x01Bud1").unwrap();
}

fn of_macos(root: &Path) -> Vec<Camera> {
    let all = images_in_folder(root);
    strays(&root.join("images"), |index| format!("{index}.png"));
    all
}

/// Writes LLFF's array with the first `count` cameras.
fn llff(root: &Path, count: usize) -> Vec<Camera> {
    let all = cameras(Intrinsics { fx: 51.5, fy: 51.5, cx: 30.0, cy: 20.0, ..pinhole() });
    (0..9).for_each(|index| save_image(&root.join(format!("images/{index}.png")), 60, 40));
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({count}, 17), }}\n");
    let mut bytes =
        [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
    for camera in &all[..count] {
        let (r, o) = (camera.rotation, camera.origin);
        let last = [40.0, 60.0, 51.5];
        let rows = (0..3).flat_map(|i| [-r.y_axis[i], r.x_axis[i], r.z_axis[i], o[i], last[i]]);
        rows.chain([1.0, 9.0]).for_each(|value| bytes.extend(f64::to_le_bytes(value)));
    }
    fs::write(root.join("poses_bounds.npy"), bytes).unwrap();
    all
}

fn llff_of_macos(root: &Path) -> Vec<Camera> {
    let all = llff(root, 9);
    strays(&root.join("images"), |index| format!("{index}.png"));
    all
}

fn llff_without_all_poses(root: &Path) -> Vec<Camera> {
    llff(root, 5);
    Vec::new()
}
