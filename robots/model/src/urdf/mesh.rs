//! Triangles of mesh files: STL (binary and ASCII), OBJ and COLLADA (DAE). Colours, normals and textures are not read.
//!
//! Boxes need only the surface. Existing readers (`stl_io`, `tobj`) give indexed vertices and more, and for COLLADA
//! there is no maintained one. The three formats together are shorter here than the code to use those readers would
//! be.

use nalgebra::{Matrix4, Vector3};
use roxmltree::{Document, Node};

/// Content of a mesh file by its name in the URDF file, or the reason why it is not available.
pub type MeshFiles<'a> = dyn Fn(&str) -> Result<Vec<u8>, String> + 'a;

pub(super) type Triangle = [Vector3<f64>; 3];

/// Most triangles of a mesh.
const TRIANGLES_MAX: usize = 5_000_000;

/// The triangles of the mesh `name`, in the unit of the file (COLLADA: in metres).
pub(super) fn triangles(name: &str, bytes: &[u8]) -> Result<Vec<Triangle>, String> {
    let lower = name.to_lowercase();
    let text = || std::str::from_utf8(bytes).map_err(|_| format!("{name} is not text"));
    let read = match lower.rsplit('.').next() {
        Some("stl") => binary_stl(bytes).or_else(|| ascii_stl(&String::from_utf8_lossy(bytes))),
        Some("obj") => obj(text()?),
        Some("dae") => {
            let document = Document::parse(text()?).map_err(|e| format!("{name} is not valid XML: {e}"))?;
            collada(document.root_element())
        }
        _ => return Err(format!("{name}: only stl, obj and dae are read; convert it to one of them")),
    };
    let read = read.filter(|all| !all.is_empty() && all.len() <= TRIANGLES_MAX);
    let read = read.filter(|all| all.iter().flatten().all(|corner| corner.iter().all(|v| v.is_finite())));
    read.ok_or_else(|| format!("{name} is damaged or has no triangles"))
}

fn binary_stl(bytes: &[u8]) -> Option<Vec<Triangle>> {
    const HEADER: usize = 84;
    const FACET: usize = 50;
    let count = u32::from_le_bytes(bytes.get(80..HEADER)?.try_into().ok()?) as usize;
    // The length decides: the first word alone does not prove an ASCII file, and an ASCII file of exactly this length does not
    // occur.
    if bytes.len() != count.checked_mul(FACET)?.checked_add(HEADER)? {
        return None;
    }
    let corner = |at: &[u8]| {
        let number = |k: usize| f64::from(f32::from_le_bytes([at[k], at[k + 1], at[k + 2], at[k + 3]]));
        Vector3::new(number(0), number(4), number(8))
    };
    let facet = |f: &[u8]| [corner(&f[12..24]), corner(&f[24..36]), corner(&f[36..48])];
    Some(bytes[HEADER..].chunks_exact(FACET).map(facet).collect())
}

fn ascii_stl(text: &str) -> Option<Vec<Triangle>> {
    let mut corners = Vec::new();
    for line in text.lines() {
        if let Some(rest) = line.trim().strip_prefix("vertex") {
            corners.push(triple(&mut rest.split_whitespace())?);
        }
    }
    Some(corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect())
}

fn obj(text: &str) -> Option<Vec<Triangle>> {
    let (mut corners, mut out) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => corners.push(triple(&mut words)?),
            Some("f") => {
                // From 1, or from the last one backwards; texture and normal follow behind slashes.
                let index = |word: &str| {
                    let number: i64 = word.split('/').next()?.parse().ok()?;
                    let k = if number < 0 { corners.len() as i64 + number } else { number - 1 };
                    corners.get(usize::try_from(k).ok()?).copied()
                };
                fan(&words.map(index).collect::<Option<Vec<_>>>()?, &mut out);
            }
            _ => {}
        }
    }
    Some(out)
}

/// A polygon as triangles.
fn fan(corners: &[Vector3<f64>], out: &mut Vec<Triangle>) {
    out.extend(corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]]));
}

fn triple<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<Vector3<f64>> {
    let mut next = || words.next()?.parse::<f64>().ok();
    Some(Vector3::new(next()?, next()?, next()?))
}

/// Geometries in the places where the scene puts them; z up, metres.
fn collada(root: Node<'_, '_>) -> Option<Vec<Triangle>> {
    let asset = child(root, "asset");
    let unit = asset.and_then(|a| child(a, "unit")?.attribute("meter")?.parse::<f64>().ok()).unwrap_or(1.0);
    // The up axis of a file is ignored, as ROS does: URDF files turn the mesh themselves.
    let scene = root.descendants().find(|n| n.has_tag_name("visual_scene"));
    let mut out = Vec::new();
    match scene {
        Some(scene) => place(root, scene, &Matrix4::new_scaling(unit), &mut out, 0)?,
        None => {
            for geometry in root.descendants().filter(|n| n.has_tag_name("geometry")) {
                collada_mesh(geometry, &Matrix4::new_scaling(unit), &mut out)?;
            }
        }
    }
    Some(out)
}

/// Deepest tree of nodes.
const DEPTH_MAX: usize = 64;

fn place(
    root: Node<'_, '_>,
    node: Node<'_, '_>,
    x: &Matrix4<f64>,
    out: &mut Vec<Triangle>,
    depth: usize,
) -> Option<()> {
    let mut x = *x;
    for part in node.children().filter(|_| depth < DEPTH_MAX) {
        let numbers = || numbers(part);
        match part.tag_name().name() {
            "matrix" => x *= Matrix4::from_row_slice(numbers()?.get(..16)?),
            "translate" => x *= Matrix4::new_translation(&Vector3::from_column_slice(numbers()?.get(..3)?)),
            "scale" => {
                x *= Matrix4::new_nonuniform_scaling(&Vector3::from_column_slice(numbers()?.get(..3)?));
            }
            "rotate" => {
                let n = numbers()?;
                let axis = Vector3::from_column_slice(n.get(..3)?).try_normalize(1e-9)?;
                x *= Matrix4::new_rotation(axis * n.get(3)?.to_radians());
            }
            "instance_geometry" => {
                let id = part.attribute("url")?.strip_prefix('#')?;
                collada_mesh(by_id(root, id)?, &x, out)?;
            }
            "node" => place(root, part, &x, out, depth + 1)?,
            _ => {}
        }
    }
    Some(())
}

fn collada_mesh(geometry: Node<'_, '_>, x: &Matrix4<f64>, out: &mut Vec<Triangle>) -> Option<()> {
    let Some(mesh) = child(geometry, "mesh") else { return Some(()) };
    let kinds = ["triangles", "polylist", "polygons"];
    for part in mesh.children().filter(|n| kinds.contains(&n.tag_name().name())) {
        let inputs = || part.children().filter(|n| n.has_tag_name("input"));
        let offset =
            |n: Node<'_, '_>| n.attribute("offset").and_then(|v| v.parse::<usize>().ok()).unwrap_or(0);
        let stride = inputs().map(offset).max()? + 1;
        let vertex = inputs().find(|n| n.attribute("semantic") == Some("VERTEX"))?;
        let vertices = by_id(mesh, vertex.attribute("source")?.strip_prefix('#')?)?;
        let position = vertices.children().find(|n| n.attribute("semantic") == Some("POSITION"))?;
        let source = by_id(mesh, position.attribute("source")?.strip_prefix('#')?)?;
        let values = numbers(child(source, "float_array")?)?;
        let corner = |at: f64| {
            let k = 3 * at as usize;
            let v = values.get(k..k + 3)?;
            Some(x.transform_point(&nalgebra::Point3::new(v[0], v[1], v[2])).coords)
        };
        let counts = child(part, "vcount").map_or(Some(Vec::new()), numbers)?;
        let mut counts = counts.into_iter();
        for list in part.children().filter(|n| n.has_tag_name("p")) {
            let indices = numbers(list)?;
            let all: Vec<f64> = indices.chunks_exact(stride).map(|c| c[offset(vertex)]).collect();
            let mut rest = &all[..];
            while !rest.is_empty() {
                let count = match part.tag_name().name() {
                    "triangles" => 3,
                    "polygons" => rest.len(),
                    _ => counts.next()? as usize,
                };
                let (polygon, behind) = rest.split_at_checked(count.max(1))?;
                fan(&polygon.iter().map(|k| corner(*k)).collect::<Option<Vec<_>>>()?, out);
                rest = behind;
            }
        }
    }
    Some(())
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    node.children().find(|n| n.has_tag_name(name))
}

fn by_id<'a, 'i>(root: Node<'a, 'i>, id: &str) -> Option<Node<'a, 'i>> {
    root.descendants().find(|n| n.attribute("id") == Some(id))
}

fn numbers(node: Node<'_, '_>) -> Option<Vec<f64>> {
    node.text().unwrap_or("").split_whitespace().map(|word| word.parse().ok()).collect()
}
