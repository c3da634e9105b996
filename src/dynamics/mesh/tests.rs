//! Claims about meshes, each with what was measured.

use super::*;
use crate::scene::{Element, Obstacle, Scene};
use crate::sensors::cast::{NOTHING, PinholeCamera, RangeLimits, RayCaster, RayScene, RayTarget, Rays};
use crate::shape::{Geometry, Shape};
use crate::spatial::add;
use crate::uneven_ground::{GroundWave, UnevenGround};
use rng::{Purpose, Stream};

fn stream(which: u64) -> Stream {
    Stream::new(61, which, 0, Purpose::user(61))
}

fn vector(r: &mut Stream, size: f64) -> Vec3<f64> {
    [0, 1, 2].map(|_| r.uniform(-size, size))
}

fn attitude(r: &mut Stream) -> [f64; 4] {
    unit([r.normal(), r.normal(), r.normal(), r.normal()])
}

/// The corners and twelve triangles of a box about the origin.
fn cuboid(size: Vec3<f64>) -> (Vec<Vec3<f64>>, Vec<[u32; 3]>) {
    let corner = |i: u32| [0, 1, 2].map(|k| if i >> k & 1 == 1 { 0.5 * size[k] } else { -0.5 * size[k] });
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let split = |[a, b, c, d]: [u32; 4]| [[a, b, c], [a, c, d]];
    ((0..8).map(corner).collect(), faces.into_iter().flat_map(split).collect())
}

/// A ball of 20 · 4ⁿ triangles whose corners lie at `radius`.
fn ball(n: usize, radius: f64) -> (Vec<Vec3<f64>>, Vec<[u32; 3]>) {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let mut points: Vec<Vec3<f64>> = Vec::new();
    for k in 0..3 {
        for (a, b) in [(1.0, golden), (-1.0, golden), (1.0, -golden), (-1.0, -golden)] {
            let mut p = [0.0; 3];
            (p[k], p[(k + 1) % 3]) = (a, b);
            points.push(p);
        }
    }
    let near = |a: &Vec3<f64>, b: &Vec3<f64>| dot(sub(*a, *b), sub(*a, *b)) < 4.1;
    let mut faces: Vec<[u32; 3]> = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let [p, q, s] = [points[a], points[b], points[c]];
                if near(&p, &q) && near(&q, &s) && near(&s, &p) {
                    let out = dot(area([p, q, s]), p) > 0.0;
                    faces.push(if out { [a, b, c] } else { [a, c, b] }.map(|i| i as u32));
                }
            }
        }
    }
    for _ in 0..n {
        let mut middles = std::collections::HashMap::new();
        let mut halved = Vec::new();
        for [a, b, c] in faces {
            let mut middle = |i: u32, j: u32| {
                *middles.entry([i.min(j), i.max(j)]).or_insert_with(|| {
                    points.push(scale(0.5, add(points[i as usize], points[j as usize])));
                    points.len() as u32 - 1
                })
            };
            let [x, y, z] = [middle(a, b), middle(b, c), middle(c, a)];
            halved.extend([[a, x, z], [x, b, y], [z, y, c], [x, y, z]]);
        }
        faces = halved;
        points.iter_mut().for_each(|p| *p = scale(1.0 / dot(*p, *p).sqrt(), *p));
    }
    points.iter_mut().for_each(|p| *p = scale(radius / dot(*p, *p).sqrt(), *p));
    (points, faces)
}

fn mesh(name: &str, (vertices, triangles): (Vec<Vec3<f64>>, Vec<[u32; 3]>)) -> Mesh {
    Mesh::new(name, vertices, triangles).unwrap().only_seen()
}

fn world_of(mesh: Vec<Mesh>) -> RayScene {
    let scene = Scene { mesh, ..Scene::default() };
    scene.validate().unwrap();
    let mut world = RayScene::default();
    world.fill(&scene, &[]).unwrap();
    world
}

fn look(world: &RayScene, position: Vec3<f64>, directions: &[Vec3<f64>], most: f64) -> (Vec<f32>, Vec<u32>) {
    let rays = Rays::new(directions, RangeLimits { least: 0.0, most }).unwrap();
    let pose = Pose { position, attitude: upright() };
    let (mut t, mut ids) = (vec![0.0; directions.len()], vec![0; directions.len()]);
    RayCaster::new().rays(world, &rays, &pose, &mut t, &mut ids);
    (t, ids)
}

#[test]
fn a_box_of_twelve_triangles_has_the_ranges_and_normals_of_a_box() {
    let (mut worst, mut apart, mut hits) = (0.0_f64, 0, 0);
    for which in 0..50 {
        let mut r = stream(which);
        let (size, position, rotation) =
            ([0, 1, 2].map(|_| r.uniform(0.2, 2.0)), vector(&mut r, 1.0), attitude(&mut r));
        let unit_box = mesh("box", cuboid(scale(1e3, size))).scaled(1e-3).at(position).turned(rotation);
        let seen = world_of(vec![unit_box]);
        let mut solid = RayScene::default();
        let known = solid.push_box(&Pose { position, attitude: rotation }, size, 0).unwrap();
        let mut eye = vector(&mut r, 4.0);
        while dot(eye, eye) < 9.0 {
            eye = vector(&mut r, 4.0);
        }
        let aim = |r: &mut Stream| sub(add(position, vector(r, 1.2)), eye);
        let directions: Vec<_> = (0..200).map(|_| aim(&mut r)).collect();
        let ((t, ids), (want, want_ids)) = (look(&seen, eye, &directions, 20.0), look(&solid, eye, &directions, 20.0));
        for i in 0..200 {
            let error = f64::from((t[i] - want[i]).abs()) / (1.0 + f64::from(want[i]));
            if error > 1e-3 || (ids[i] == NOTHING) != (want_ids[i] == NOTHING) {
                apart += 1;
                continue;
            }
            worst = worst.max(error);
            if ids[i] != NOTHING {
                hits += 1;
                let d = scale(1.0 / dot(directions[i], directions[i]).sqrt(), directions[i]);
                let point = add(eye, scale(f64::from(want[i]), d));
                let (n, m) = (seen.normal(ids[i], point).unwrap(), solid.normal(known, point).unwrap());
                apart += usize::from(dot(n, m) < 1.0 - 1e-6);
            }
        }
    }
    println!("{hits} of 10000 rays hit, ranges differ by at most {worst:.1e} (1 + t), {apart} on edges");
    assert!(worst < 1e-5 && hits > 2_000 && apart <= 2, "{worst:e} {hits} {apart}");
}

#[test]
fn a_ball_of_triangles_is_seen_just_inside_the_ball_and_no_ray_slips_through_it() {
    let (points, faces) = ball(4, 1.0);
    let seen = world_of(vec![mesh("ball", (points.clone(), faces.clone()))]);
    let mut solid = RayScene::default();
    solid.push_capsule([[0.0; 3]; 2], 1.0, 0).unwrap();
    let eye = [-2.5, 0.4, 0.9];
    // at corners and middles of edges, that face the eye
    let mut targets: Vec<_> = points.clone();
    targets.extend(faces.iter().map(|[a, b, _]| scale(0.5, add(points[*a as usize], points[*b as usize]))));
    targets.retain(|p| dot(*p, sub(eye, *p)) > 0.3);
    let directions: Vec<_> = targets.iter().map(|p| sub(*p, eye)).collect();
    let ((t, ids), (want, _)) = (look(&seen, eye, &directions, 10.0), look(&solid, eye, &directions, 10.0));
    let mut worst = 0.0_f32;
    for i in 0..t.len() {
        let way = dot(directions[i], directions[i]).sqrt() as f32;
        // it ends where it was aimed at, which is on the surface or behind the ball's
        assert!(ids[i] != NOTHING && (t[i] - way).abs() < 1e-5, "{i}: {} {way}", t[i]);
        assert!(t[i] > want[i] - 1e-5, "{i}: {} {}", t[i], want[i]);
        worst = worst.max(t[i] - want[i]);
    }
    println!("{} rays at {} triangles, at most {worst:.1e} m behind the ball", t.len(), faces.len());
    // measured 6.3e-3: an edge sinks by 2.5e-3 m, and is met at up to 83°
    assert!(worst < 0.02 && t.len() > 1_000, "{worst}");
}

#[test]
fn images_and_scans_of_meshes_are_those_of_all_triangles_bit_for_bit() {
    let mut caster = RayCaster::new();
    let mut hits = 0;
    for which in 0..25 {
        let mut r = stream(1_000 + which);
        let place =
            |mesh: Mesh, r: &mut Stream| mesh.at(vector(r, 2.0)).turned(attitude(r)).scaled(r.uniform(0.3, 1.5));
        let one = place(mesh("ball", ball(2, 1.0)), &mut r);
        let other = place(mesh("box", cuboid([1.0, 0.2, 0.6])), &mut r);
        let mut world = world_of(vec![one, other]);
        world.push_capsule([vector(&mut r, 2.0), vector(&mut r, 2.0)], 0.2, 0).unwrap();
        let pose = Pose { position: vector(&mut r, 3.0), attitude: attitude(&mut r) };
        let range = RangeLimits { least: r.uniform(0.0, 0.5), most: r.uniform(2.0, 9.0) };
        let camera = PinholeCamera::new(21, 13, 1.8, range).unwrap();
        let n = 21 * 13;
        let (mut a, mut b) = ((vec![0.0; n], vec![0; n]), (vec![0.0; n], vec![0; n]));
        caster.image(&world, &camera, &pose, &mut a.0, &mut a.1);
        caster.image_of_all(&world, &camera, &pose, &mut b.0, &mut b.1);
        assert_eq!(a, b, "scene {which}");
        let directions: Vec<_> = (0..n).map(|_| rotate(attitude(&mut r), [1.0, 0.0, 0.0])).collect();
        let rays = Rays::new(&directions, range).unwrap();
        caster.rays(&world, &rays, &pose, &mut a.0, &mut a.1);
        caster.rays_of_all(&world, &rays, &pose, &mut b.0, &mut b.1);
        assert_eq!(a, b, "scene {which}");
        hits += a.1.iter().filter(|id| matches!(world.owner(**id), Some(RayTarget::Scene(Element::Mesh(_))))).count();
    }
    println!("{hits} rays of scans hit a mesh");
    assert!(hits > 100, "{hits}");
}

#[test]
fn a_mesh_is_seen_from_outside_only_and_its_ids_name_it() {
    let near = mesh("near", cuboid([1.0; 3])).at([3.0, 0.0, 0.0]);
    let far = mesh("far", cuboid([1.0; 3])).at([6.0, 0.0, 0.0]);
    let world = world_of(vec![near, far]);
    let ahead = [[1.0, 0.01, 0.02]];
    let (t, ids) = look(&world, [0.0; 3], &ahead, 10.0);
    assert!((t[0] - 2.5).abs() < 1e-2 && world.owner(ids[0]) == Some(RayTarget::Scene(Element::Mesh(0))), "{t:?}");
    let normal = world.normal(ids[0], [2.5, 0.0, 0.0]).unwrap();
    assert!((normal[0] + 1.0).abs() < 1e-12, "{normal:?}");
    let (t, ids) = look(&world, [3.0, 0.0, 0.0], &ahead, 10.0);
    assert!((t[0] - 2.5).abs() < 1e-2 && world.owner(ids[0]) == Some(RayTarget::Scene(Element::Mesh(1))), "{t:?}");
    assert_eq!(world.owner(u32::MAX >> 9), None);
}

#[test]
fn a_height_field_is_the_relief_that_it_was_sampled_from() {
    let wave = GroundWave { amplitude: 0.3, number: [0.8, 0.5], phase: 0.2 };
    let relief = UnevenGround { slope: [0.1, 0.0], waves: vec![wave] };
    let (n, step) = (101, 0.1);
    let row = |i: usize| (0..n).map(|j| relief.rise(step * j as f64, step * i as f64).0).collect();
    let field = Mesh::height_field("dem", (0..n).map(row).collect(), [step; 2]).unwrap().only_seen();
    let seen = world_of(vec![field]);
    let mut ground = RayScene::default();
    ground.fill(&Scene { relief: Some(relief), ..Scene::grounded() }, &[]).unwrap();
    let mut r = stream(2_000);
    let (mut worst, mut sum) = (0.0_f64, 0);
    for _ in 0..20 {
        let eye = [r.uniform(3.0, 7.0), r.uniform(3.0, 7.0), r.uniform(2.5, 3.5)];
        let directions: Vec<_> = (0..50).map(|_| [r.uniform(-0.6, 0.6), r.uniform(-0.6, 0.6), -1.0]).collect();
        let ((t, _), (want, _)) = (look(&seen, eye, &directions, 20.0), look(&ground, eye, &directions, 20.0));
        for i in 0..50 {
            worst = worst.max(f64::from((t[i] - want[i]).abs()) / (1.0 + f64::from(want[i])));
            sum += 1;
        }
    }
    println!("{sum} ranges of a height field differ from those of its relief by at most {worst:.1e} (1 + t)");
    assert!(worst < 1e-3, "{worst:e}"); // a cell of 0.1 m leaves 0.3 mm to a curvature of 0.27/m
    // from below and from the side it is closed
    let (_, ids) = look(&seen, [5.0, 5.0, -5.0], &[[0.1, 0.1, 1.0]], 20.0);
    assert_ne!(ids[0], NOTHING);
    let (_, ids) = look(&seen, [-5.0, 5.0, -0.8], &[[1.0, 0.01, 0.0]], 20.0);
    assert_ne!(ids[0], NOTHING);
}

#[test]
fn what_cannot_be_a_mesh_is_told_with_value_limit_and_remedy() {
    let (points, faces) = cuboid([1.0; 3]);
    let told = |points: &[Vec3<f64>], faces: &[[u32; 3]]| {
        Mesh::new("it", points.to_vec(), faces.to_vec()).unwrap_err().to_string()
    };
    let with = |k: usize, face: [u32; 3]| {
        let mut faces = faces.clone();
        faces[k] = face;
        faces
    };
    let mut broken = points.clone();
    broken[3][1] = f64::NAN;
    let inside_out: Vec<_> = faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    for (text, start) in [
        (told(&points, &faces[..3]), "mesh 'it': number of triangles is 3, below the limit of 4 to 1000000."),
        (told(&points, &vec![[0, 1, 2]; 1_000_001]), "mesh 'it': number of triangles is 1000001, over the limit"),
        (told(&broken, &faces), "mesh 'it': vertex 3[1] is NaN, but it must be a finite number"),
        (told(&[[1e12; 3]; 8], &faces), "mesh 'it': vertex 0 is 1000000000000, but it must be within ±1e9"),
        (told(&points, &with(2, [0, 9, 1])), "mesh 'it': triangle 2: corner is 9, but it must be below 8"),
        (told(&points, &with(2, [4, 4, 5])), "mesh 'it': triangle 2: area is 0e0, but it must be above 0"),
        (
            told(&points, &faces[1..]),
            "mesh 'it': number of open edges is 3, the first from [-0.5, -0.5, -0.5] to [-0.5, 0.5, -0.5], but it must be 0",
        ),
        (
            told(&points, &inside_out),
            "mesh 'it': volume is -9.999999999999999e-1, but it must be above 0: corners go counter-clockwise",
        ),
    ] {
        assert!(text.starts_with(start), "{text}");
    }
    let field = |heights: Vec<Vec<f64>>, spacing| Mesh::height_field("dem", heights, spacing).unwrap_err().to_string();
    for (text, start) in [
        (field(vec![vec![0.0; 3]], [1.0; 2]), "mesh 'dem': heights is 1 x 3, but it must be 2 x 2 or more"),
        (field(vec![vec![0.0; 3], vec![0.0; 2]], [1.0; 2]), "mesh 'dem': length of heights[1] is 2, but it must be 3"),
        (field(vec![vec![0.0, f64::NAN]; 2], [1.0; 2]), "mesh 'dem': heights[0][1] is NaN"),
        (field(vec![vec![0.0; 2]; 2], [0.0, 1.0]), "mesh 'dem': spacing[0]"),
        (field(vec![vec![0.0; 800]; 800], [1.0; 2]), "mesh 'dem': number of triangles is 1286390, over the limit"),
    ] {
        assert!(text.starts_with(start), "{text}");
    }
    let touched = Scene { mesh: vec![Mesh::new("it", points, faces).unwrap()], ..Scene::default() };
    let text = touched.validate().unwrap_err().to_string();
    assert!(text.starts_with("mesh 'it': contact is true unless told otherwise, but it must be false"), "{text}");
    assert!(text.ends_with("stand boxes or capsules in for what is to be touched."), "{text}");
    let large = Scene { mesh: vec![mesh("it", cuboid([1.0; 3])).scaled(1e6)], ..Scene::default() };
    assert!(large.validate().unwrap_err().to_string().starts_with("mesh 'it': size times scale"));
    let twice = Scene { mesh: vec![mesh("it", cuboid([1.0; 3])), mesh("it", cuboid([1.0; 3]))], ..Scene::default() };
    assert!(twice.validate().unwrap_err().to_string().starts_with("scene: mesh name is 'it' twice"));
}

/// The bytes of an STL file.
fn stl((points, faces): &(Vec<Vec3<f64>>, Vec<[u32; 3]>), binary: bool) -> Vec<u8> {
    if !binary {
        let corner = |i: &u32| points[*i as usize].map(|x| format!("{x}")).join(" ");
        let facet = |face: &[u32; 3]| {
            let corners: Vec<_> = face.iter().map(|i| format!("vertex {}\n", corner(i))).collect();
            format!("facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n", corners.concat())
        };
        let facets: Vec<_> = faces.iter().map(facet).collect();
        return format!("solid it\n{}endsolid it\n", facets.concat()).into_bytes();
    }
    let mut bytes = b"solid as text begins".to_vec();
    bytes.resize(80, 0);
    bytes.extend((faces.len() as u32).to_le_bytes());
    for face in faces {
        bytes.extend([0; 12]);
        face.iter().flat_map(|i| points[*i as usize]).for_each(|x| bytes.extend((x as f32).to_le_bytes()));
        bytes.extend([0; 2]);
    }
    bytes
}

#[test]
fn a_scene_file_names_meshes_from_its_own_folder_and_comes_back_from_its_toml() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let solid = cuboid([1.0, 2.0, 3.0]);
    std::fs::write(at("binary.stl"), stl(&solid, true)).unwrap();
    std::fs::write(at("text.STL"), stl(&solid, false)).unwrap();
    std::fs::write(at("dem.csv"), "0.0, 0.5, 0.0\n0.1, 0.6, 0.1\n").unwrap();
    let text = "ground = 0.0\n\
        [[mesh]]\nname = 'a'\nfile = 'binary.stl'\ncontact = false\nscale = 2.0\nposition = [5, 0, 3]\n\
        [[mesh]]\nname = 'b'\nfile = 'text.STL'\ncontact = false\n\
        [[mesh]]\nname = 'c'\nfile = 'dem.csv'\nspacing = [2.0, 1.0]\ncontact = false\n\
        [[mesh]]\nname = 'd'\nheights = [[0, 1], [0, 1]]\nspacing = [1.0, 1.0]\ncontact = false\n";
    std::fs::write(at("scene.toml"), text).unwrap();
    let scene = Scene::from_toml_file(at("scene.toml")).unwrap();
    assert_eq!(scene.mesh.iter().map(Mesh::n_triangle).collect::<Vec<_>>(), [12, 12, 22, 14]);
    let back = Scene::from_toml_str(&toml::to_string(&scene).unwrap(), "back.toml").unwrap();
    assert_eq!(back, scene);
    let mut inline = scene.clone();
    inline.mesh.push(mesh("e", solid));
    assert_eq!(toml::from_str::<Scene>(&toml::to_string(&inline).unwrap()).unwrap(), inline);
}

#[test]
fn the_scene_of_the_documentation_can_be_read() {
    let text = include_str!("../../../docs/sensors.md");
    let meshes = text.split("### Meshes").nth(1).unwrap();
    let table = meshes.split("```toml").nth(1).unwrap().split("```").next().unwrap();
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("hall.stl"), stl(&cuboid([4000.0; 3]), true)).unwrap();
    std::fs::write(folder.path().join("scene.toml"), table).unwrap();
    let scene = Scene::from_toml_file(folder.path().join("scene.toml")).unwrap();
    assert_eq!(scene.mesh.len(), 2);
}

#[test]
fn a_scene_file_tells_what_is_wrong_with_its_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).unwrap();
    let whole = stl(&cuboid([1.0; 3]), true);
    let open = {
        let (points, faces) = cuboid([1.0; 3]);
        stl(&(points, faces[1..].to_vec()), true)
    };
    write("whole.stl", &whole);
    write("open.stl", &open);
    write("cut.stl", &whole[..200]);
    write("words.csv", b"1, 2\n3, four\n");
    let told = |table: &str| {
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, format!("[[mesh]]\nname = 'it'\n{table}\n")).unwrap();
        Scene::from_toml_file(&path).unwrap_err().to_string()
    };
    for (table, part) in [
        ("file = 'whole.stl'", "scene.toml: mesh 'it': contact: is true unless told otherwise, but it must be false"),
        ("file = 'open.stl'\ncontact = false", "mesh 'it': number of open edges: is 3, the first from"),
        ("file = 'cut.stl'\ncontact = false", "is no STL ("),
        ("file = 'none.stl'\ncontact = false", "none.stl: "),
        ("file = 'words.csv'\nspacing = [1, 1]\ncontact = false", "words.csv: line 2: 'four' is no number"),
        ("file = 'whole.obj'\ncontact = false", "it must be a name that ends in .stl, or one in .csv with a spacing"),
        ("contact = false", "but it must be one of file, vertices with triangles, and heights with spacing"),
        ("fil = 'whole.stl'", "unknown field `fil`"),
    ] {
        let text = told(table);
        assert!(text.contains(part), "{text}");
    }
}

#[test]
fn a_flight_in_a_scene_sees_its_meshes_and_nothing_touches_them() {
    use crate::configurations::environment::vehicle_in;
    use crate::sensors::{OnboardSensors, SensorConfig};
    use crate::{Physics, Plant, vehicles};
    let wall = mesh("wall", cuboid([1.0, 8.0, 8.0])).at([3.0, 0.0, 0.0]);
    let scene = Scene { mesh: vec![wall], ..Scene::grounded() };
    let vehicle = vehicles::by_name("hummingbird").unwrap();
    let model = vehicle_in(&vehicle, &scene).unwrap();
    let bare = vehicle_in(&vehicle, &Scene::grounded()).unwrap();
    assert_eq!(model.shapes(), bare.shapes());
    let plant = Plant::of_model(&model, Physics::default()).unwrap();
    let text = "name = 'a'\nkind = 'lidar'\nbeams = 4\nelevations = [0.0]\nfarthest = 5.0\n";
    let config: SensorConfig = toml::from_str(text).unwrap();
    let mut aboard = OnboardSensors::new(&[config], &plant).unwrap();
    let mut state = plant.tree().unwrap().rest_state();
    state[2] = 1.0;
    let told = aboard.read(&state, &state);
    assert!((told[0] - 2.5).abs() < 1e-5 && told[1..].iter().all(|x| *x == 5.0), "{told:?}");
    let solid = Obstacle { name: "wall".into(), shape: Shape::new(Geometry::Box { size: [1.0; 3] }) };
    let touched = vehicle_in(&vehicle, &Scene { obstacles: vec![solid], ..Scene::grounded() }).unwrap();
    assert_eq!(touched.shapes().len(), bare.shapes().len() + 1);
}

/// Tetrahedra along a line toward the origin whose sizes fall by 2^−`halvings` in all.
fn falling(n: usize, halvings: f64) -> (Vec<Vec3<f64>>, Vec<[u32; 3]>) {
    let (mut points, mut faces) = (Vec::new(), Vec::new());
    for k in 0..n {
        let (size, first) = ((-halvings * k as f64 / n as f64).exp2(), points.len() as u32);
        let corners = [[1.0, 0.0, 0.0], [1.3, 0.0, 0.0], [1.0, 0.3, 0.0], [1.0, 0.0, 0.3]];
        points.extend(corners.map(|p| scale(size, p)));
        faces.extend([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]].map(|f: [u32; 3]| f.map(|i| first + i)));
    }
    (points, faces)
}

#[test]
fn a_mesh_whose_triangles_shrink_toward_a_point_is_made_in_seconds_and_seen_as_triangle_by_triangle() {
    let mut longest = 0.0_f64;
    for (n, halvings) in [(15_000, 100.0), (4_000, 12.0), (15_000, 20.0), (4_000, 200.0), (4_000, 0.0), (3, 1.0)] {
        let begun = std::time::Instant::now();
        let falls = mesh("falls", falling(n, halvings)).placed();
        longest = longest.max(begun.elapsed().as_secs_f64());
        let mut r = stream(n as u64 + halvings as u64);
        let mut hits = 0;
        for _ in 0..20 {
            let target = scale((-r.uniform(0.0, halvings)).exp2(), [1.05, r.uniform(0.0, 0.2), 0.05]);
            let origin = [r.uniform(2.0, 3.0), r.uniform(-1.0, 3.0), 1.0];
            let direction = sub(target, origin);
            let met = falls.nearest(origin, direction, 1e3);
            // smaller triangles are points to a ray from here, and no sign of theirs is sure
            if halvings <= 20.0 {
                assert_eq!(met, falls.nearest_of_all(origin, direction), "{n} {halvings}");
            }
            hits += usize::from(met.is_some());
        }
        assert!(hits > 0, "{n} {halvings}");
    }
    println!("the longest took {longest:.2} s");
    assert!(longest < 10.0, "{longest}");
}

#[test]
fn a_file_that_many_meshes_name_is_read_once_and_all_of_them_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("ball.stl"), stl(&ball(5, 1.0), true)).unwrap();
    std::fs::write(folder.path().join("dem.csv"), "0.0, 0.5, 0.0\n0.1, 0.6, 0.1\n").unwrap();
    let read = |n: usize, file: &str| {
        let table = |k: usize| format!("[[mesh]]\nname = 'm{k}'\nposition = [{k}, 0, 0]\ncontact = false\n{file}\n");
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, (0..n).map(table).collect::<String>()).unwrap();
        Scene::from_toml_file(&path)
    };
    let begun = std::time::Instant::now();
    for file in ["file = 'ball.stl'", "file = 'dem.csv'\nspacing = [1, 1]"] {
        let scene = read(300, file).unwrap();
        assert!(scene.mesh.iter().all(|mesh| Arc::ptr_eq(&mesh.surface, &scene.mesh[0].surface)), "{file}");
        assert_eq!((scene.mesh[7].name.as_str(), scene.mesh[7].position), ("m7", [7.0, 0.0, 0.0]));
        let text = read(4097, file).unwrap_err().to_string();
        assert!(text.contains("number of meshes") && text.contains("4096"), "{text}");
    }
    // 409 of 20480 triangles each
    assert!(read(396, "file = 'ball.stl'").is_ok());
    let text = read(397, "file = 'ball.stl'").unwrap_err().to_string();
    assert!(text.contains("triangles of all meshes") && text.contains("8126464"), "{text}");
    println!("took {:.2} s", begun.elapsed().as_secs_f64());
}

#[cfg(unix)]
#[test]
fn a_file_of_many_names_is_read_once_and_names_are_told_before_any_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    std::fs::write(path("0.stl"), stl(&ball(3, 1.0), true)).unwrap();
    std::fs::write(path("1.STL"), stl(&ball(3, 1.0), true)).unwrap();
    let n = 40;
    for k in 2..n {
        let (name, first) = (path(&format!("{k}.stl")), path("0.stl"));
        if k % 2 == 0 { std::fs::hard_link(first, name) } else { std::os::unix::fs::symlink(first, name) }.unwrap();
    }
    std::fs::hard_link(path("0.stl"), path("0.txt")).unwrap();
    let read = |names: &[(String, String)]| {
        let table =
            |(name, file): &(String, String)| format!("[[mesh]]\nname = '{name}'\ncontact = false\nfile = '{file}'\n");
        std::fs::write(path("scene.toml"), names.iter().map(table).collect::<String>()).unwrap();
        Scene::from_toml_file(path("scene.toml"))
    };
    let of = |k: usize| (format!("m{k}"), if k == 1 { "1.STL".into() } else { format!("{k}.stl") });
    let mut all: Vec<_> = (0..n).map(of).collect();
    let scene = read(&all).unwrap();
    for (k, mesh) in scene.mesh.iter().enumerate() {
        assert_eq!(Arc::ptr_eq(&mesh.surface, &scene.mesh[0].surface), k != 1, "{k}");
        assert!(matches!(&mesh.source, Source::File(own) if *own == path(&all[k].1)), "{k}");
    }
    all[7] = ("m7".into(), "0.txt".into());
    assert!(read(&all).unwrap_err().to_string().contains("a name that ends in .stl"));
    all[0].1 = "nowhere.stl".into();
    all[39].0 = "m8".into();
    let text = read(&all).unwrap_err().to_string();
    assert!(text.contains("mesh name: is 'm8' twice"), "{text}");
}

#[test]
#[ignore = "a measurement: cargo test --workspace --lib rays_per_second_at_five_thousand_triangles -- --ignored --nocapture"]
fn rays_per_second_at_five_thousand_triangles() {
    let world = world_of(vec![mesh("ball", ball(4, 1.0))]);
    let camera = PinholeCamera::new(64, 48, 0.8, RangeLimits { least: 0.0, most: 10.0 }).unwrap();
    let pose = Pose { position: [-3.0, 0.1, 0.05], attitude: upright() };
    let (mut t, mut ids, mut caster) = (vec![0.0; 64 * 48], vec![0; 64 * 48], RayCaster::new());
    let begun = std::time::Instant::now();
    for _ in 0..100 {
        caster.image(&world, &camera, &pose, &mut t, &mut ids);
    }
    let per_second = 100.0 * t.len() as f64 / begun.elapsed().as_secs_f64();
    let hits = ids.iter().filter(|id| **id != NOTHING).count();
    println!("{:.2} million rays/s at 5120 triangles, {hits} of {} hit", per_second / 1e6, t.len());
}
