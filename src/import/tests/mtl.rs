//! MTL: what each statement means, and that a broken library costs only what is broken.

use std::path::Path;

use crate::import::mtl;
use crate::import::report::ImportReport;
use crate::model::{ImageMap, MaterialRecord};

/// Reads a library; warnings without the path.
fn library(text: &[u8]) -> (Vec<MaterialRecord>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mtl");
    std::fs::write(&path, text).unwrap();
    let mut report = ImportReport::default();
    let mut records = Vec::new();
    mtl::read(&path, None, &mut report, &mut |record| {
        records.push(record);
        true
    })
    .unwrap();
    let warning = |warning: &crate::import::Warning| match warning.line {
        Some(line) => format!("{line}: {}", warning.text),
        None => warning.text.clone(),
    };
    (records, report.warnings.iter().map(warning).collect())
}

#[test]
fn statements() {
    let text = b"# remark\nnewmtl red glass\n  Kd 1 0.5 0.25\nKs .1 .2 .3\nKe 3 2 1\nNs 50\nNi 1.5\nd 0.25\nTf 0.9 0.8 0.7\n\
        illum 7\nKa 1 1 1\n\nnewmtl plain\r\nKd 0.5\r\nTr 0.25\r\nNi 0\r\nillum 2\r\n";
    let (records, warnings) = library(text);
    assert_eq!(warnings, [""; 0]);
    assert_eq!(
        records[0],
        MaterialRecord {
            name: "red glass".into(),
            diffuse: [1.0, 0.5, 0.25],
            specular: [0.1, 0.2, 0.3],
            shininess: 50.0,
            emission: [3.0, 2.0, 1.0],
            opacity: 0.25,
            transmission: [0.9, 0.8, 0.7],
            refractive_index: 1.5,
            mirror: true,
            roughness: 0.0,
            metalness: 0.0,
            exponent_by_roughness: false,
            images: None,
        }
    );
    assert_eq!(
        records[1],
        MaterialRecord {
            name: "plain".into(),
            diffuse: [0.5; 3],
            opacity: 0.75,
            ..MaterialRecord::default()
        }
    );
}

#[test]
fn roughness_and_metalness_of_the_extension_for_physically_based_materials() {
    let text = b"newmtl a\nPr 0.375\nPm 1\nillum 3\nnewmtl b\nPr 7\nnewmtl c\nPr rough\nPr 0.5\nnewmtl d\nPr -1\nnewmtl e\nPr none\n\
        Prx 1\nPr";
    let (records, warnings) = library(text);
    let found: Vec<f32> = records.iter().map(|record| record.roughness).collect();
    assert_eq!(found, [0.375, 1.0, 0.5, 0.0, 0.0]);
    let a = MaterialRecord {
        name: "a".into(),
        mirror: true,
        roughness: 0.375,
        metalness: 1.0,
        ..MaterialRecord::default()
    };
    assert_eq!(records[0], a);
    assert_eq!(warnings, ["15: `Pr` without a number; it is left out", "12: `Pr` is NaN; 0 is taken"]);
}

#[test]
fn broken_statements_cost_only_themselves() {
    let text = b"Kd 1 1 1\nnewmtl a\nKd 1 x 1\nKs 0.5 0.5 0.5\nNs\nKd spectral file.rfl\nd -halo 0.5\nmap_Kd\nillum 300\n\
        newmtl\nKd 0 0 0\nnewmtl \xE9\nKd nan 0 inf\nd 7\nKe -1 0 0\nTf xyz 1 2 3";
    let (records, warnings) = library(text);
    assert_eq!(records.len(), 2);
    assert_eq!((records[0].specular, records[0].opacity), ([0.5; 3], 0.5));
    assert_eq!(records[0].diffuse, MaterialRecord::default().diffuse);
    assert_eq!(records[1].name, "\u{E9}");
    assert_eq!(records[1].diffuse, [0.7, 0.0, 0.7]);
    assert_eq!((records[1].opacity, records[1].emission), (1.0, [0.0; 3]));
    assert_eq!(
        warnings,
        [
            "5: `Ns` without a number; it is left out",
            "6: `Kd` needs one or three numbers; it is left out",
            "3: `Kd 1 x 1` is not understood; it is left out",
            "9: `illum 300` is not understood; it is left out",
            "10: a material without a name; it is left out",
            "1 texture statements are left out",
            "12: `Kd` is NaN; 0.7 is taken",
            "12: `Kd` is inf; 0.7 is taken",
            "12: `Tf` is NaN; 1 is taken",
        ]
    );
}

#[test]
fn a_missing_library_is_an_error_of_the_system() {
    let mut report = ImportReport::default();
    assert!(mtl::read(Path::new("no such file.mtl"), None, &mut report, &mut |_| true).is_err());
}

#[test]
fn images_are_found_and_placed() {
    let place = tempfile::tempdir().unwrap();
    let (folder, library) = (place.path(), place.path().join("sub/a.mtl"));
    std::fs::create_dir(folder.join("sub")).unwrap();
    for name in ["sub/wood grain.png", "sub/b.png"] {
        std::fs::write(folder.join(name), "").unwrap();
    }
    let text = "newmtl a\nmap_Kd -s 2 3 1 -o 0.5 -clamp on wood grain.png\nmap_Bump -bm 0.25 b.png\n\
        newmtl b\nmap_Ks C:\\work\\b.png\nmap_d -imfchan m b.png\nnorm b.png\nmap_Ka b.png\n\
        newmtl c\nmap_Kd missing.png\nmap_Ks -s 1 1\n";
    std::fs::write(&library, text).unwrap();
    let (mut report, mut records) = (ImportReport::default(), Vec::new());
    mtl::read(&library, Some(folder), &mut report, &mut |record| {
        records.push(record);
        true
    })
    .unwrap();
    let images: Vec<_> = records.iter().map(|record| record.images.as_deref()).collect();
    let [Some(a), Some(b), None] = images[..] else { panic!("{images:?}") };
    let b_png = || ImageMap::new("sub/b.png");
    let wood = ImageMap {
        scale: [2.0, 3.0],
        offset: [0.5, 0.0],
        clamp: true,
        ..ImageMap::new("sub/wood grain.png")
    };
    assert_eq!(a.diffuse, Some(wood));
    assert_eq!(a.bump, Some(ImageMap { strength: 0.25, ..b_png() }));
    assert_eq!([&b.specular, &b.opacity, &b.normal], [&Some(b_png()), &Some(b_png()), &Some(b_png())]);
    // A picture without a number stands alone.
    let text = "newmtl a\nmap_Ke b.png\nmap_Pr -s 2 b.png\nmap_Pm b.png\nnewmtl b\nKe 0.5 0 0\nmap_Ke b.png\nPr 0.25\n\
        map_Pr b.png\nPm 0\nmap_Pm b.png\nnewmtl c\nmap_Ke missing.png\n";
    std::fs::write(&library, text).unwrap();
    let mut records = Vec::new();
    mtl::read(&library, Some(folder), &mut ImportReport::default(), &mut |record| {
        records.push(record);
        true
    })
    .unwrap();
    let numbers = |record: &MaterialRecord| (record.emission, record.roughness, record.metalness);
    let found: Vec<_> = records.iter().map(numbers).collect();
    assert_eq!(found, [([1.0; 3], 1.0, 1.0), ([0.5, 0.0, 0.0], 0.25, 0.0), ([0.0; 3], 0.0, 0.0)]);
    let images = records[0].images.as_ref().unwrap();
    assert_eq!([&images.emission, &images.metalness], [&Some(b_png()), &Some(b_png())]);
    assert_eq!(images.roughness, Some(ImageMap { scale: [2.0, 1.0], ..b_png() }));
    assert!(records[2].images.is_none());
    let warnings: Vec<_> = report.warnings.iter().map(|warning| warning.text.as_str()).collect();
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(warnings[0].contains("`missing.png` is not there") && warnings[1].contains("without an image"));
    assert!(warnings[2].contains("1 texture statements are left out"));
}
