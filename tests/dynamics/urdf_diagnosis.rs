//! Wrong files, one defect each: every message names the file, the place, the rule with the value, and the remedy.

use omnidrones::dynamics::shape::Geometry;
use omnidrones::dynamics::urdf::{Import, ImportOptions, RotorFile, export, import_model_text, import_text};
use omnidrones::error::{Error, Result};

const ROTORS: &str = "
[defaults]
thrust_coefficient = 6.0e-6
moment_per_thrust = 0.015
max_speed = 830.0
time_constant = 0.02

[[rotors]]
link = 'rotor_0'
spin = 1

[[rotors]]
link = 'rotor_1'
spin = -1
";

const BODY: &str = "<link name='body'>
<inertial><origin xyz='0 0 0' rpy='0 0 0'/><mass value='1.0'/>
<inertia ixx='0.01' ixy='0' ixz='0' iyy='0.01' iyz='0' izz='0.015'/></inertial>
</link>";

/// A sound file of four links: body, two rotors, a fixed box.
fn sound() -> String {
    let mut text = format!("<robot name='r'>\n{BODY}\n");
    for (name, kind, y) in
        [("rotor_0", "continuous", "0.2"), ("rotor_1", "continuous", "-0.2"), ("box", "fixed", "0.0")]
    {
        text += &format!(
            "<link name='{name}'><inertial><mass value='0.02'/>\
             <inertia ixx='2e-6' ixy='0' ixz='0' iyy='2e-6' iyz='0' izz='3e-6'/></inertial></link>\n\
             <joint name='{name}_joint' type='{kind}'><origin xyz='0 {y} 0.01'/>\
             <parent link='body'/><child link='{name}'/><axis xyz='0 0 1'/></joint>\n"
        );
    }
    text + "</robot>\n"
}

/// The sound file with its rotor data in `<properties>`.
fn with_properties() -> String {
    sound().replacen("<robot name='r'>", "<robot name='r'><properties kf='5e-10' km='5e-12' thrust2weight='2'/>", 1)
}

fn import(urdf: &str, rotors: &str) -> Result<Import> {
    let rotors = RotorFile::parse(rotors, "v.rotors.toml")?;
    import_text(urdf, "v.urdf", Some(&rotors), &ImportOptions::default())
}

/// (name, text to replace in the sound file, its replacement, words of the error: place, rule, remedy).
type Row = (&'static str, &'static str, &'static str, [&'static str; 3]);

const WRONG_URDF: &[Row] = &[
    (
        "empty mass",
        "value='1.0'",
        "value=''",
        ["line 3, <mass> of link 'body'", "must hold 1 number", "Correct the count"],
    ),
    ("NaN mass", "value='1.0'", "value='NaN'", ["line 3, <mass> of link 'body'", "value is NaN", "finite number"]),
    ("infinite mass", "value='1.0'", "value='inf'", ["<mass> of link 'body'", "value is inf", "finite number"]),
    ("overflowing mass", "value='1.0'", "value='1e999'", ["<mass> of link 'body'", "value is inf", "finite number"]),
    ("absurd mass", "value='1.0'", "value='1e300'", ["<mass> of link 'body'", "1e300", "check the units"]),
    ("negative mass", "value='1.0'", "value='-1.0'", ["line 2, link 'body'", "mass is -1 kg", "Correct the sign"]),
    (
        "word for mass",
        "value='1.0'",
        "value='heavy'",
        ["<mass> of link 'body'", "'heavy', which is not a number", "plain numbers"],
    ),
    (
        "xacro expression",
        "value='1.0'",
        "value='${m}'",
        ["<mass> of link 'body'", "'${m}', which is not a number", "plain"],
    ),
    (
        "xacro argument",
        "xyz='0 0 0'",
        "xyz='0 0 $(arg z)'",
        ["<origin> of link 'body'", "'$(arg', which is not a number", "run xacro, and import its output"],
    ),
    ("decimal comma", "value='1.0'", "value='1,1'", ["<mass> of link 'body'", "'1,1'", "a decimal point, not a comma"]),
    (
        "three decimal commas",
        "xyz='0 0.2 0.01'",
        "xyz='0,0 0,2 0,01'",
        ["<origin> of joint 'rotor_0_joint'", "'0,0'", "a decimal point, not a comma"],
    ),
    (
        "decimal commas and semicolons",
        "xyz='0 0.2 0.01'",
        "xyz='0;0,2;0,01'",
        ["<origin> of joint 'rotor_0_joint'", "'0;0,2;0,01'", "a decimal point, not a comma, and separated by blanks"],
    ),
    (
        "commas between numbers",
        "xyz='0 0.2 0.01'",
        "xyz='0,0.2,0.01'",
        ["<origin> of joint 'rotor_0_joint'", "'0,0.2,0.01'", "separated by blanks, not by commas"],
    ),
    (
        "commas and blanks between numbers",
        "xyz='0 0.2 0.01'",
        "xyz='0, 0.2, 0.01'",
        ["<origin> of joint 'rotor_0_joint'", "'0,'", "separated by blanks, not by commas"],
    ),
    (
        "mass without value",
        "<mass value='1.0'/>",
        "<mass/>",
        ["<mass> of link 'body'", "'value' is missing", "Add value="],
    ),
    ("no mass", "<mass value='1.0'/>", "", ["<inertial> of link 'body'", "<mass> is missing", "Add <mass"]),
    (
        "two masses",
        "<mass value='1.0'/>",
        "<mass value='1'/><mass value='2'/>",
        ["<mass> of link 'body'", "a second <mass>", "Keep one"],
    ),
    (
        "no inertia",
        "<inertia ixx='0.01' ixy='0' ixz='0' iyy='0.01' iyz='0' izz='0.015'/>",
        "",
        ["<inertial> of link 'body'", "<inertia> is missing", "Add <inertia"],
    ),
    ("NaN inertia", "izz='0.015'", "izz='nan'", ["line 4, <inertia> of link 'body'", "izz is NaN", "finite number"]),
    ("triangle inequality", "izz='0.015'", "izz='0.05'", ["link 'body'", "triangle inequality", "recompute"]),
    ("negative inertia", "ixx='0.01'", "ixx='-0.01'", ["link 'body'", "positive semi-definite", "units (kg m²)"]),
    (
        "indefinite products",
        "ixy='0' ixz='0' iyy='0.01'",
        "ixy='0.5' ixz='0' iyy='0.01'",
        ["link 'body'", "positive semi-definite", "signs of the products"],
    ),
    ("missing moment", " izz='0.015'", "", ["<inertia> of link 'body'", "'izz' is missing", "Add izz="]),
    (
        "unsymmetric inertia",
        "ixy='0' ixz='0' iyy='0.01'",
        "ixy='0' iyx='0.001' ixz='0' iyy='0.01'",
        ["<inertia> of link 'body'", "not symmetric: iyx = 0.001", "Remove iyx"],
    ),
    ("NaN origin", "xyz='0 0 0'", "xyz='0 NaN 0'", ["<origin> of link 'body'", "xyz is NaN", "finite number"]),
    (
        "two numbers",
        "xyz='0 0 0'",
        "xyz='0 0'",
        ["<origin> of link 'body'", "must hold 3 numbers", "Correct the count"],
    ),
    (
        "four numbers",
        "xyz='0 0 0'",
        "xyz='0 0 0 0'",
        ["<origin> of link 'body'", "must hold 3 numbers", "Correct the count"],
    ),
    (
        "a stray word",
        "xyz='0 0 0'",
        "xyz='0 x 0 0'",
        ["<origin> of link 'body'", "'x', which is not a number", "plain numbers"],
    ),
    (
        "far away",
        "xyz='0 0.2 0.01'",
        "xyz='0 1e12 0'",
        ["<origin> of joint 'rotor_0_joint'", "1e12, over the limit", "units"],
    ),
    ("infinite rpy", "rpy='0 0 0'", "rpy='0 0 -inf'", ["<origin> of link 'body'", "rpy is -inf", "finite number"]),
    (
        "two links of one name",
        "<link name='box'>",
        "<link name='body'>",
        ["link 'body'", "second link is called 'body'", "Rename"],
    ),
    (
        "two joints of one name",
        "name='box_joint'",
        "name='rotor_0_joint'",
        ["joint 'rotor_0_joint'", "second joint is called", "Rename"],
    ),
    (
        "dangling parent",
        "<parent link='body'/><child link='box'/>",
        "<parent link='bdy'/><child link='box'/>",
        ["<parent> of joint 'box_joint'", "'bdy' does not exist (did you mean 'body'?)", "Correct the name"],
    ),
    (
        "dangling child",
        "<child link='box'/>",
        "<child link='crate'/>",
        ["<child> of joint 'box_joint'", "'crate' does not exist", "add the link"],
    ),
    (
        "no parent",
        "<parent link='body'/><child link='box'/>",
        "<child link='box'/>",
        ["joint 'box_joint'", "<parent> is missing", "Add <parent"],
    ),
    ("no child", "<child link='box'/>", "", ["joint 'box_joint'", "<child> is missing", "Add <child"]),
    (
        "empty parent",
        "<parent link='body'/><child link='box'/>",
        "<parent link=''/><child link='box'/>",
        ["<parent> of joint 'box_joint'", "link is empty", "Give it a name"],
    ),
    (
        "two parents",
        "</robot>",
        "<joint name='again' type='fixed'><parent link='rotor_0'/><child link='box'/></joint></robot>",
        ["joint 'again'", "has two parents: joint 'box_joint'", "remove the other"],
    ),
    (
        "cycle",
        "</robot>",
        "<joint name='back' type='fixed'><parent link='box'/><child link='body'/></joint></robot>",
        ["link 'body'", "a cycle", "Remove a joint"],
    ),
    (
        "its own parent",
        "<parent link='body'/><child link='box'/>",
        "<parent link='box'/><child link='box'/>",
        ["link 'box'", "a cycle", "Remove a joint"],
    ),
    (
        "two roots",
        "</robot>",
        "<link name='loose'/></robot>",
        ["link 'loose'", "2 roots ('body', 'loose')", "Join the links"],
    ),
    (
        "zero axis",
        "<axis xyz='0 0 1'/>",
        "<axis xyz='0 0 0'/>",
        ["<axis> of joint 'rotor_0_joint'", "'0 0 0' has no direction", "\"0 0 1\" is up"],
    ),
    (
        "NaN axis",
        "<axis xyz='0 0 1'/>",
        "<axis xyz='0 0 NaN'/>",
        ["<axis> of joint 'rotor_0_joint'", "xyz is NaN", "finite number"],
    ),
    (
        "axis without numbers",
        "<axis xyz='0 0 1'/>",
        "<axis/>",
        ["<axis> of joint 'rotor_0_joint'", "'xyz' is missing", "Add xyz="],
    ),
    (
        "unknown joint type",
        "type='fixed'",
        "type='welded'",
        ["joint 'box_joint'", "joint type 'welded' is unknown", "Use one of fixed, revolute"],
    ),
    ("no joint type", " type='fixed'", "", ["joint 'box_joint'", "'type' is missing", "Add type="]),
    ("nameless link", "<link name='box'>", "<link>", ["<link>", "'name' is missing", "Add name="]),
    ("nameless joint", "<joint name='box_joint' ", "<joint ", ["<joint>", "'name' is missing", "Add name="]),
    (
        "NaN limit",
        "<axis xyz='0 0 1'/>",
        "<axis xyz='0 0 1'/><limit effort='1' velocity='NaN'/>",
        ["<limit> of joint 'rotor_0_joint'", "velocity is NaN", "finite number"],
    ),
    (
        "limit without velocity",
        "<axis xyz='0 0 1'/>",
        "<axis xyz='0 0 1'/><limit effort='1'/>",
        ["<limit> of joint 'rotor_0_joint'", "'velocity' is missing", "Add velocity="],
    ),
    (
        "mimics nothing",
        "<axis xyz='0 0 1'/>",
        "<axis xyz='0 0 1'/><mimic joint='ghost'/>",
        ["<mimic> of joint 'rotor_0_joint'", "'ghost', which does not exist", "Name a joint"],
    ),
    ("open comment", "type='fixed'", "type='revolute'><!--", ["line 11", "a comment (<!--) is not closed", "Close it"]),
    (
        "prismatic rotor",
        "type='continuous'",
        "type='prismatic'",
        ["joint 'rotor_0_joint'", "of type 'prismatic'", "use continuous"],
    ),
    (
        "two shapes",
        "</inertial></link>\n<joint name='box_joint'",
        "</inertial><visual><geometry><sphere radius='1'/><box size='1 1 1'/></geometry></visual></link><joint name='box_joint'",
        ["<geometry> of link 'box'", "holds 2 shapes", "Use one of box"],
    ),
    (
        "NaN box",
        "</inertial></link>\n<joint name='box_joint'",
        "</inertial><collision><geometry><box size='1 NaN 1'/></geometry></collision></link><joint name='box_joint'",
        ["<box> of link 'box'", "size is NaN", "finite number"],
    ),
    (
        "shape without size",
        "</inertial></link>\n<joint name='box_joint'",
        "</inertial><collision><geometry><cylinder radius='1'/></geometry></collision></link><joint name='box_joint'",
        ["<cylinder> of link 'box'", "'length' is missing", "Add length="],
    ),
    ("wrong root element", "robot", "model", ["<model>", "root element is <model>", "<robot name="]),
    ("not XML", "<robot name='r'>", "<robot name='r'", ["line 1", "is not closed", "Close it"]),
    ("wrong end tag", "</robot>", "</robt>", ["line 12", "not well-formed XML", "Correct the markup"]),
    ("unknown entity", "name='r'", "name='&bomb;'", ["line 1", "not well-formed XML", "Correct the markup"]),
    (
        "document type",
        "<robot name='r'>",
        "<!DOCTYPE robot [<!ENTITY a 'b'>]><robot name='r'>",
        ["line 1", "document types and entities", "Remove the <!DOCTYPE"],
    ),
    (
        "xacro",
        "<robot name='r'>",
        "<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:include filename='a'/>",
        ["<include>", "xacro:include is not expanded", "Run xacro yourself"],
    ),
    (
        "blank in a name",
        "<link name='box'>",
        "<link name='box '>",
        ["link 'box '", "blanks at its ends", "Remove the blanks"],
    ),
    (
        "incomplete properties are checked",
        "<robot name='r'>",
        "<robot name='r'><properties kf='NaN'/>",
        ["<properties>", "kf is NaN", "finite number"],
    ),
    (
        "negative properties are refused",
        "<robot name='r'>",
        "<robot name='r'><properties km='-1'/>",
        ["<properties>", "km is -1", "Check its sign"],
    ),
];

/// A file that carries its rotor data in `<properties>`, broken in one place; no rotor file.
const WRONG_PROPERTIES: &[Row] = &[
    ("no km", " km='5e-12'", "", ["<properties>", "km is missing", "write a rotor file"]),
    ("zero kf", "kf='5e-10'", "kf='0'", ["<properties>", "kf is 0, but it must be > 0", "real rotor"]),
    (
        "absurd ratio",
        "thrust2weight='2'",
        "thrust2weight='1e200'",
        ["<properties>", "must lie between 0 and 1e9", "sign and unit"],
    ),
    ("no rotor links", "rotor_", "wheel_", ["<properties>", "0 links are named like one", "Name the rotor links"]),
    ("two of them", "<properties", "<properties/><properties", ["<properties>", "a second <properties>", "Keep one"]),
];

const WRONG_ROTORS: &[Row] = &[
    (
        "unknown link",
        "link = 'rotor_1'",
        "link = 'rotor_11'",
        ["[[rotors]] 1 (link 'rotor_11')", "no link 'rotor_11' (did you mean 'rotor_1'?)", "It has: body"],
    ),
    (
        "unknown joint",
        "link = 'rotor_1'",
        "joint = 'rotor_1_joynt'",
        ["[[rotors]] 1 (joint 'rotor_1_joynt')", "did you mean 'rotor_1_joint'?", "It has: rotor_0_joint"],
    ),
    (
        "one link twice",
        "link = 'rotor_1'",
        "link = 'rotor_0'",
        ["[[rotors]] 1 (link 'rotor_0')", "on the same link", "its own link"],
    ),
    ("no place", "link = 'rotor_1'", "", ["[[rotors]] 1", "link, joint or position is missing", "where the rotor is"]),
    ("two spins in one", "spin = -1", "spin = 2", ["vehicle", "rotor 'rotor_1': spin is 2", "Swap the sign"]),
    ("no spin", "spin = -1", "", ["[[rotors]] 1 (link 'rotor_1')", "spin is missing", "counter-clockwise"]),
    (
        "no thrust",
        "thrust_coefficient = 6.0e-6",
        "",
        ["[[rotors]] 0", "thrust_coefficient is missing", "[defaults] serves"],
    ),
    ("negative thrust", "6.0e-6", "-6.0e-6", ["[[rotors]] 0", "thrust_coefficient is -0.000006", "SI units"]),
    ("NaN thrust", "6.0e-6", "nan", ["[[rotors]] 0", "thrust_coefficient is NaN", "finite number"]),
    ("infinite speed", "830.0", "inf", ["[[rotors]] 0", "max_speed is inf", "finite number"]),
    ("no lag", "time_constant = 0.02", "", ["[[rotors]] 0", "time_constant_up is missing", "in seconds"]),
    ("negative lag", "0.02", "-0.02", ["vehicle", "time_constant_up is -0.02", "SI units"]),
    (
        "misspelt key",
        "max_speed",
        "max_sped",
        ["line 5", "key 'max_sped' is unknown (did you mean 'max_speed'?)", "Known: name"],
    ),
    (
        "misspelt table",
        "[defaults]",
        "[default]",
        ["line 2", "key 'default' is unknown (did you mean 'defaults'?)", "Known:"],
    ),
    (
        "a word for a number",
        "spin = -1",
        "spin = 'left'",
        ["line 14", "does not read as a rotor file", "Correct this line"],
    ),
    (
        "both speeds",
        "max_speed = 830.0",
        "max_speed = 830.0\nmax_thrust = 4.0",
        ["[defaults]", "both max_speed and max_thrust", "Keep one"],
    ),
    (
        "default link",
        "time_constant = 0.02",
        "time_constant = 0.02\nlink = 'body'",
        ["[defaults]", "same name, link, joint or position", "into each [[rotors]]"],
    ),
    ("zero axis", "spin = -1", "spin = -1\naxis = [0, 0, 0]", ["[[rotors]] 1", "no direction", "[0, 0, 1] is up"]),
    (
        "NaN position",
        "spin = -1",
        "spin = -1\nposition = [0.0, nan, 0.0]",
        ["[[rotors]] 1", "position is NaN", "finite"],
    ),
    (
        "one name twice",
        "spin = -1",
        "spin = -1\nname = 'rotor_0'",
        ["[[rotors]] 1", "second rotor is called 'rotor_0'", "Rename"],
    ),
    ("not TOML", "[defaults]", "[defaults", ["line 2", "does not read as a rotor file", "Correct this line"]),
    (
        "negative extra mass",
        "spin = -1",
        "spin = -1\n[[parts]]\nname = 'p'\nmass = -1\ninertia = { xx = 0, yy = 0, zz = 0 }",
        ["[[parts]] 0 ('p')", "mass is -1", "≥ 0"],
    ),
    (
        "huge extra inertia",
        "spin = -1",
        "spin = -1\n[[parts]]\nname = 'p'\nmass = 1\ninertia = { xx = 1e308, yy = 1e308, zz = 1e308 }",
        ["[[parts]] 0 ('p')", "inertia is 1", "SI units"],
    ),
    (
        "extra part of a known name",
        "spin = -1",
        "spin = -1\n[[parts]]\nname = 'body'\nmass = 1\ninertia = { xx = 0, yy = 0, zz = 0 }",
        ["[[parts]] 0 ('body')", "called 'body' too", "Rename"],
    ),
    ("negative drag", "spin = -1", "spin = -1\n[drag]\nlinear = [-1, 0, 0]", ["[drag]", "linear is -1", "≥ 0"]),
    (
        "NaN gain",
        "spin = -1",
        "spin = -1\n[gains]\nposition = [nan, 0, 0]\nvelocity = [0, 0, 0]\nattitude = [0, 0, 0]\nrate = [0, 0, 0]",
        ["[gains]", "position is NaN", "≥ 0"],
    ),
];

/// Every file above, broken and with its rotor file, and the sound ones they come from.
pub fn files() -> Vec<(String, Option<String>)> {
    let (sound, with_properties) = (sound(), with_properties());
    let put = |text: &str, (_, from, to, _): &Row| text.replacen(from, to, 1);
    let mut all = vec![(sound.clone(), Some(ROTORS.to_string())), (with_properties.clone(), None)];
    all.extend(WRONG_URDF.iter().map(|row| (put(&sound, row), Some(ROTORS.to_string()))));
    all.extend(WRONG_PROPERTIES.iter().map(|row| (put(&with_properties, row), None)));
    all.extend(WRONG_ROTORS.iter().map(|row| (sound.clone(), Some(put(ROTORS, row)))));
    all
}

fn judge(name: &str, file: &str, words: &[&str; 3], result: Result<Import>) -> Option<String> {
    let error = match result {
        Ok(_) => return Some(format!("{name}: accepted")),
        Err(error) => error,
    };
    let text = error.to_string();
    let kind = matches!(error, Error::Format { .. } | Error::Limit { .. } | Error::Value { .. });
    let missing: Vec<_> = words.iter().filter(|w| !text.contains(**w)).collect();
    let fine = kind && missing.is_empty() && text.starts_with(file) && !text.contains('\n');
    (!fine).then(|| format!("{name}: lacks {missing:?}: {text}"))
}

#[test]
fn the_sound_file_that_the_table_breaks_imports_without_a_warning() {
    let import = import(&sound(), ROTORS).unwrap();
    assert!(import.warnings.is_empty(), "{:#?}", import.warnings);
    assert_eq!(import.vehicle.rotors[1].position, [0.0, -0.2, 0.01]);
}

#[test]
fn every_wrong_urdf_is_refused_with_place_rule_and_remedy() {
    let mut bad = Vec::new();
    for (name, from, to, words) in WRONG_URDF {
        let sound = sound();
        assert!(sound.contains(from), "{name}: '{from}' is not in the sound file");
        // The root's name occurs twice; every other defect is put in once.
        let wrong = if *from == "robot" { sound.replace(from, to) } else { sound.replacen(from, to, 1) };
        bad.extend(judge(name, "v.urdf", words, import(&wrong, ROTORS)));
    }
    assert!(bad.is_empty(), "{} of {}:\n{}", bad.len(), WRONG_URDF.len(), bad.join("\n"));
}

#[test]
fn every_wrong_properties_element_is_refused_with_place_rule_and_remedy() {
    let text = with_properties();
    let import = |text: &str| import_text(text, "v.urdf", None, &ImportOptions::default());
    assert!((import(&text).unwrap().vehicle.thrust_to_weight() - 2.0).abs() < 1e-12);
    let broken = |from: &str, to: &str| text.replace(from, to);
    let bad: Vec<_> = WRONG_PROPERTIES
        .iter()
        .filter_map(|(name, from, to, words)| judge(name, "v.urdf", words, import(&broken(from, to))))
        .collect();
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}

#[test]
fn a_quaternion_origin_is_read_from_version_1_1_on_and_warned_about_before() {
    let text = sound().replacen(
        "<origin xyz='0 0.2 0.01'/>",
        "<origin xyz='0 0.2 0.01' quat_xyzw='0.7071067811865476 0 0 0.7071067811865476'/>",
        1,
    );
    let old = import(&text, ROTORS).unwrap();
    assert_eq!(old.vehicle.rotors[0].axis, [0.0, 0.0, 1.0]);
    assert!(old.warnings[0].to_string().contains("<origin quat_xyzw>: quat_xyzw is read only from version 1.1 on"));
    let new = import(&text.replacen("<robot ", "<robot version='1.1' ", 1), ROTORS).unwrap();
    assert!(new.warnings.is_empty());
    assert!((new.vehicle.rotors[0].axis[1] + 1.0).abs() < 1e-12, "{:?}", new.vehicle.rotors[0].axis);
}

#[test]
fn every_wrong_rotor_file_is_refused_with_place_rule_and_remedy() {
    let mut bad = Vec::new();
    for (name, from, to, words) in WRONG_ROTORS {
        assert!(ROTORS.contains(from), "{name}");
        bad.extend(judge(name, "v.rotors.toml", words, import(&sound(), &ROTORS.replacen(from, to, 1))));
    }
    assert!(bad.is_empty(), "{} of {}:\n{}", bad.len(), WRONG_ROTORS.len(), bad.join("\n"));
}

#[test]
fn a_moving_leaf_needs_mass_and_inertia_unless_it_is_a_rotor() {
    let inertial =
        "<inertial><mass value='0.02'/><inertia ixx='2e-6' ixy='0' ixz='0' iyy='2e-6' iyz='0' izz='3e-6'/></inertial>";
    let bare = |text: String, link: &str| {
        let link = format!("<link name='{link}'>");
        text.replacen(&format!("{link}{inertial}"), &link, 1)
    };
    let moving = sound().replace("type='fixed'", "type='revolute'");
    let error = import(&bare(moving.clone(), "box"), ROTORS).unwrap_err().to_string();
    assert!(
        error.contains("joint 'box_joint': link 'box' moves on this revolute joint but carries no mass"),
        "{error}"
    );
    let point = moving.replacen("<link name='box'><inertial><mass value='0.02'/><inertia ixx='2e-6' ixy='0' ixz='0' iyy='2e-6' iyz='0' izz='3e-6'/>",
        "<link name='box'><inertial><mass value='0.02'/><inertia ixx='0' ixy='0' ixz='0' iyy='0' iyz='0' izz='0'/>", 1);
    assert!(import(&point, ROTORS).unwrap_err().to_string().contains("carries no inertia"));
    let rotor = import(&bare(sound(), "rotor_0"), ROTORS).unwrap();
    assert!(rotor.warnings.iter().any(|w| w.element == "link 'rotor_0'" && w.rule.contains("without mass")));
}

#[test]
fn a_moving_joint_that_is_no_rotor_is_held_at_zero_with_a_warning() {
    let import = import(&sound().replace("type='fixed'", "type='revolute'"), ROTORS).unwrap();
    let text = import.warnings.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    assert!(
        text.starts_with("v.urdf:11: joint 'box_joint': a revolute joint that is no rotor's is held at zero."),
        "{text}"
    );
    assert!(text.contains("import_model_file"), "{text}");
    assert!(import.assumptions.iter().any(|a| a.contains("'rotor_0_joint'")), "{:?}", import.assumptions);
}

#[test]
fn a_moving_link_without_mass_is_taken_where_what_is_welded_to_it_resists_its_joint() {
    let inertial =
        "<inertial><mass value='0.02'/><inertia ixx='2e-6' ixy='0' ixz='0' iyy='2e-6' iyz='0' izz='3e-6'/></inertial>";
    let tip = |x: &str| {
        let tip = format!(
            "<link name='tip'><inertial><mass value='0.02'/><inertia ixx='0' ixy='0' ixz='0' iyy='0' iyz='0' izz='0'/>\
             </inertial></link><joint name='weld' type='fixed'><origin xyz='{x} 0 0.05'/><parent link='box'/>\
             <child link='tip'/></joint></robot>"
        );
        let box_link = "<link name='box'>";
        let moving = sound().replace("type='fixed'", "type='revolute'").replace("</robot>", &tip);
        moving.replacen(&format!("{box_link}{inertial}"), box_link, 1).replace(
            "xyz='0 0 1'/></joint>",
            "xyz='0 0 1'/><limit velocity='1' effort='0.2' lower='-1' upper='1'/></joint>",
        )
    };
    let rotors = RotorFile::parse(ROTORS, "v.rotors.toml").unwrap();
    let model = import_model_text(&tip("0.1"), "v.urdf", Some(&rotors), &ImportOptions::default()).unwrap();
    let rigid = import(&tip("0.1"), ROTORS).unwrap();
    assert!((model.model.mass() - rigid.vehicle.mass_properties().mass).abs() < 1e-15);
    for said in [&model.assumptions, &rigid.assumptions] {
        assert!(said.iter().any(|s| s.starts_with("The limits of effort and velocity of joints '")), "{said:?}");
    }
    // on the axis, nothing resists
    assert!(import(&tip("0"), ROTORS).unwrap_err().to_string().contains("carries no inertia"));
}

/// The sound file under a root called `world`, on a joint of that kind.
fn under_world(kind: &str) -> String {
    let joint =
        format!("<link name='world'/><joint name='tie' type='{kind}'><parent link='world'/><child link='body'/>");
    sound().replacen(BODY, &format!("{joint}<axis xyz='0 0 1'/></joint>{BODY}"), 1)
}

#[test]
fn a_joint_to_the_world_is_told_unless_it_lets_the_vehicle_float() {
    for kind in ["fixed", "revolute", "prismatic"] {
        let read = import(&under_world(kind), ROTORS).unwrap();
        let told: Vec<String> = read.warnings.iter().map(ToString::to_string).collect();
        let rule =
            format!("v.urdf:2: joint 'tie': a {kind} joint ties link 'body' to the root 'world', which stands still.");
        let of_tie = told.iter().find(|line| line.starts_with(&rule));
        assert!(of_tie.is_some_and(|line| line.contains("flies freely all the same")), "{told:?}");
    }
    let free = import(&under_world("floating"), ROTORS).unwrap();
    assert!(free.warnings.is_empty(), "{:?}", free.warnings);
    assert_eq!(free.vehicle.rotors, import(&sound(), ROTORS).unwrap().vehicle.rotors);
    // as a model it floats or stands still, as both say
    let rotors = RotorFile::parse(ROTORS, "v.rotors.toml").unwrap();
    let model = |kind| import_model_text(&under_world(kind), "v.urdf", Some(&rotors), &ImportOptions::default());
    assert!(model("floating").is_ok());
}

#[test]
fn a_floating_joint_elsewhere_is_told_to_be_welded() {
    let told = import(&sound().replace("type='fixed'", "type='floating'"), ROTORS).unwrap().warnings;
    assert!(told.len() == 1 && told[0].rule.starts_with("a floating joint under a link that moves"), "{told:?}");
    assert!(told[0].remedy.starts_with("It is welded here: use two files"), "{told:?}");
}

#[test]
fn expressions_of_xacro_that_nobody_expanded_are_told_wherever_they_stand() {
    let mesh = "<visual><geometry><mesh filename='$(find hull)/hull.stl'/></geometry></visual>";
    for (text, value, count) in [
        (sound().replace("'body'", "'${prefix}body'"), "name '${prefix}body'", ", 4 times"),
        (sound().replace("<robot name='r'>", "<robot name='$(arg name)'>"), "name '$(arg name)'", "."),
        (sound().replacen("<link name='box'>", &format!("<link name='box'>{mesh}"), 1), "filename '$(find hull)", "."),
    ] {
        let told = import(&text, ROTORS).unwrap().warnings;
        assert!(told.len() == 1 && told[0].element == "xacro", "{told:?}");
        let line = told[0].to_string();
        let words = [value, "holds an expression that nobody expanded", count, "run xacro, and import its output"];
        assert!(words.iter().all(|word| line.contains(word)), "{line}");
    }
}

#[test]
fn collision_shapes_are_those_of_the_vehicle_or_named_as_left_out() {
    let shapes = "<collision><origin xyz='0 0 0.1' rpy='0 0 1.5707963267948966'/><geometry><box size='1 2 3'/></geometry>\
                  </collision><collision><geometry><sphere radius='0.1'/></geometry></collision>\
                  <collision><geometry><cylinder radius='0.1' length='1'/></geometry></collision>\
                  <collision><geometry><mesh filename='hull.stl'/></geometry></collision>";
    let text = sound().replacen("<link name='box'>", &format!("<link name='box'>{shapes}"), 1);
    let text = text.replace("<axis", "<safety_controller k_velocity='1'/><axis");
    let read = import(&text, ROTORS).unwrap();
    let vehicle = &read.vehicle;
    assert_eq!(vehicle.shapes[0].geometry, Geometry::Box { size: [1.0, 2.0, 3.0] });
    assert_eq!(vehicle.shapes[0].position, [0.0, 0.0, 0.11]);
    assert!((vehicle.shapes[0].rotation[3] - 0.5_f64.sqrt()).abs() < 1e-15);
    // a cylinder longer than wide is two boxes and a capsule within it
    assert_eq!((vehicle.shapes.len(), vehicle.shapes[1].position), (5, [0.0, 0.0, 0.01]));
    for k in [2, 3] {
        let Geometry::Box { size } = vehicle.shapes[k].geometry else { panic!("{:?}", vehicle.shapes[k]) };
        assert!((size[0].hypot(size[1]) - 0.2).abs() < 1e-15 && size[2] == 1.0, "{size:?}");
    }
    assert_eq!(vehicle.shapes[4].geometry, Geometry::Capsule { radius: 0.1, length: 0.8 });
    for said in [
        "The cylinders (1) in the collision geometry of 'box' touch by what fits into them: two boxes turned by 45°, which \
         stand on eight points of the rim, and where longer than wide a capsule, which rolls.",
        "The meshes (1) in the collision geometry of 'box' touch nothing, since none is opened: use boxes, cylinders, spheres \
         or capsules.",
    ] {
        assert!(read.assumptions.iter().any(|s| s == said), "{:?}", read.assumptions);
    }
    assert!(read.warnings.iter().any(|w| w.element == "<safety_controller> in <joint>"), "{:?}", read.warnings);
    // and survive the way out and back
    let (urdf, toml) = export(vehicle).unwrap();
    let again = import(&urdf, &toml).unwrap().vehicle;
    assert_eq!(again.shapes[1], vehicle.shapes[1]);
    assert!((again.shapes[0].rotation[3] - vehicle.shapes[0].rotation[3]).abs() < 1e-15);
}

#[test]
fn oddities_are_warned_about_with_place_rule_and_remedy() {
    let visual = "<visual><origin rpy='0 0 90'/><geometry><mesh filename='../m.dae'/></geometry></visual>";
    let text = sound()
        .replacen("<link name='box'>", &format!("<link name='box' color='red'>{visual}"), 1)
        .replace("</robot>", "<gazebo/><gazebo><a/></gazebo><wing span='1'/></robot>");
    let import = import(&text, ROTORS).unwrap();
    let lines: Vec<String> = import.warnings.iter().map(ToString::to_string).collect();
    for words in [
        "v.urdf:10: <link color>: unknown attribute. It is ignored",
        "v.urdf:10: <origin rpy>: an angle beyond 2π ('0 0 90'). URDF angles are radians",
        "v.urdf:10: <mesh> filename: the path '../m.dae' lies outside the file's folder. It is not opened",
        "v.urdf:12: <gazebo> in <robot>: this element is not used by the import, 2 times. Its content",
        "v.urdf:12: <wing> in <robot>: unknown element. It is ignored",
    ] {
        assert!(lines.iter().any(|l| l.contains(words)), "{words}\n{}", lines.join("\n"));
    }
    assert_eq!(lines.len(), 5, "{}", lines.join("\n"));
}

#[test]
fn a_file_without_rotor_data_says_which_file_to_write() {
    let error = import_text(&sound(), "dir/v.urdf", None, &ImportOptions::default()).unwrap_err().to_string();
    assert!(error.contains("no rotor file") && error.contains("write v.rotors.toml"), "{error}");
}

#[test]
fn too_many_links_and_too_long_names_are_refused() {
    let many: String = (0..513).map(|i| format!("<link name='l{i}'/>")).collect();
    let error = import(&format!("<robot name='r'>{many}</robot>"), ROTORS).unwrap_err().to_string();
    assert!(error.contains("number of links is 513, over the limit of 512"), "{error}");
    let error = import(&sound().replace("'box'", &format!("'{}'", "b".repeat(257))), ROTORS).unwrap_err().to_string();
    assert!(error.contains("length of name is 257 bytes, over the limit of 256 bytes"), "{error}");
    let error = import(&sound().replace("0.02", "0").replace("1.0", "0"), ROTORS).unwrap_err().to_string();
    assert!(error.contains("total is 0 kg") && error.contains("Give the airframe"), "{error}");
}
