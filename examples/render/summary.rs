//! What happened, for a person and as JSON.

use std::error::Error;
use std::path::Path;

use outcrop::MemoryBudget;
use outcrop::access::MissRatioCurve;
use outcrop::compile::{CompileReport, LazyReport, PhaseSeconds, Seconds};
use outcrop::instance::Instances;
use outcrop::octree::LazyOctree;
use outcrop::render::{Outcome, RenderReport, RenderedImage};
use outcrop::units::Bytes;
use serde_json::{Value, json};

use crate::common::process::ProcessMemory;
use crate::compiled::{Compiled, Origin};
use crate::options::Options;

/// Collects what `--stats` writes while it prints.
pub struct Summary {
    stats: Value,
}

impl Summary {
    pub fn new() -> Summary {
        Summary { stats: json!({}) }
    }

    pub fn compiled(&mut self, compiled: &Compiled) {
        println!("model     {}", compiled.story);
        self.stats["model"] = json!(compiled.story);
        let Some(report) = &compiled.report else { return };
        println!(
            "compile   {} triangles to {}: {:.2} s ({:.2} s of processor time)",
            grouped(report.triangles),
            counted(report.blocks.into(), "block"),
            report.seconds.total.wall,
            report.seconds.total.cpu
        );
        let seconds = &report.seconds;
        println!(
            "          {:.2} s reading, {:.2} s sorting, {:.2} s cutting, {:.2} s packing, {:.2} s writing",
            seconds.parse.wall,
            seconds.scatter.wall,
            seconds.cut.wall,
            seconds.encode.wall,
            seconds.write.wall
        );
        let Origin::File(path) = &compiled.origin else { return };
        println!(
            "          {}: {}, {:.2} bytes per triangle, positions {}",
            path.display(),
            Bytes(report.file_bytes),
            report.bytes_per_triangle,
            if report.error_bound == 0.0 {
                "exact".to_string()
            } else {
                format!("within {:.1e}", report.error_bound)
            }
        );
        for (count, what) in [
            (report.degenerate, "without area"),
            (report.duplicates, "doubled"),
            (report.skipped, "left out because a coordinate is not finite"),
        ] {
            if count > 0 {
                println!("          {} triangles {what}", grouped(count));
            }
        }
        self.stats["compile"] = compile_stats(report);
    }

    /// How much of a model that is compiled lazily is compiled now; `sealed` names the compiled file, if all of it is.
    pub fn lazy(&mut self, report: &LazyReport, sealed: Option<&Path>) {
        let pass = &report.first_pass;
        if report.was_reopened {
            println!("compile   went on with what an earlier run had cut");
        } else {
            println!(
                "compile   first pass {:.2} s: {:.2} s reading, {:.2} s sorting, {:.2} s writing",
                pass.total.wall + pass.write.wall,
                pass.parse.wall,
                pass.scatter.wall,
                pass.write.wall
            );
        }
        if report.details_left_out {
            println!(
                "          normals, texture coordinates and images are left out: compile the model as a whole to see them"
            );
        }
        println!(
            "          {} of {} cut, {} now in {:.2} s; {} of {} triangles are in blocks",
            grouped(report.cells_cut.into()),
            counted(report.cells.into(), "cell"),
            grouped(report.cells_cut_now.into()),
            report.cut.wall,
            grouped(report.triangles_encoded),
            grouped(report.triangles)
        );
        if report.skipped > 0 {
            println!(
                "          {} triangles left out because a coordinate is not finite",
                grouped(report.skipped)
            );
        }
        if let Some(path) = sealed {
            println!("          all of it: sealed as {}", path.display());
        }
        self.stats["lazy_compile"] = json!({
            "triangles": report.triangles,
            "skipped": report.skipped,
            "triangles_encoded": report.triangles_encoded,
            "cells": report.cells,
            "cells_cut": report.cells_cut,
            "cells_cut_now": report.cells_cut_now,
            "blocks": report.blocks,
            "working_bytes": report.working_bytes,
            "was_reopened": report.was_reopened,
            "first_pass": phases(pass),
            "cut": seconds(&report.cut),
        });
    }

    pub fn opened(&mut self, octree: &LazyOctree, picture_bytes: Bytes) {
        let (slots, blocks) = (octree.cache().slot_count(), octree.model().expected_block_count());
        let cache_bytes = Bytes(u64::from(slots) * octree.cache().slot_bytes().0);
        // A model that is compiled lazily may come to have more blocks than are expected.
        let share = if slots > blocks {
            format!("up to {}, about {} expected", counted(slots.into(), "block"), grouped(blocks.into()))
        } else {
            format!(
                "{} of {} ({:.0} %)",
                grouped(slots.into()),
                counted(blocks.into(), "block"),
                100.0 * f64::from(slots) / f64::from(blocks)
            )
        };
        println!("memory    {cache_bytes} for {share}, {picture_bytes} for the picture");
        self.stats["cache"] = json!({
            "slots": slots,
            "slot_bytes": octree.cache().slot_bytes().0,
            "blocks": blocks,
        });
    }

    /// [`Summary::opened`] for instances.
    pub fn placed(&mut self, instances: &Instances, picture_bytes: Bytes) {
        let octrees = instances.octrees();
        let cached =
            |octree: &LazyOctree| u64::from(octree.cache().slot_count()) * octree.cache().slot_bytes().0;
        let cache_bytes = Bytes(octrees.iter().map(cached).sum());
        println!(
            "memory    {cache_bytes} for the blocks of {}, {picture_bytes} for the picture",
            counted(octrees.len() as u64, "model"),
        );
        println!("instances {}", grouped(instances.instances().len() as u64));
        self.stats["instances"] = json!(instances.instances().len());
        self.stats["cache"] = json!({ "bytes": cache_bytes.0, "models": octrees.len() });
    }

    /// How much memory the view needs, by a recorded trace.
    pub fn accesses(&mut self, path: &Path, curve: &MissRatioCurve) {
        println!(
            "accesses  {} entries into {} written to {}",
            grouped(curve.accesses()),
            counted(curve.touched(), "block"),
            path.display()
        );
        for loads in [1.0, 1.1, 1.5, 2.0, 4.0] {
            let Some(need) = curve.memory_need(loads) else { continue };
            println!(
                "          {} ({}) of cache for at most {loads} loads per touched block",
                need.bytes,
                counted(need.slots.into(), "slot")
            );
            self.stats["memory_need"][loads.to_string()] =
                json!({ "slots": need.slots, "bytes": need.bytes.0 });
        }
    }

    pub fn rendered(&mut self, image: &RenderedImage, output: &Path) {
        let report = &image.report;
        let outcome = match report.outcome {
            Outcome::Complete => String::new(),
            Outcome::Cancelled => {
                format!(", STOPPED after {} of {} tiles", report.tiles_finished, report.tiles_total)
            }
        };
        println!(
            "render    {} x {}, {} per pixel, {}: {:.2} s{outcome}",
            report.width,
            report.height,
            counted(report.samples_per_pixel.into(), "sample"),
            counted(report.threads.into(), "thread"),
            report.wall_seconds
        );
        print_rays(report);
        print_blocks(report);
        for line in report.plan.explain().lines() {
            println!("effect    {line}");
        }
        println!("image     {}", output.display());
        self.stats["render"] = serde_json::from_str(&report.to_json()).unwrap_or_default();
        self.stats["image"] = json!(output.display().to_string());
    }

    /// The last lines, and the file of `--stats`.
    pub fn end(mut self, options: &Options, budget: &MemoryBudget) -> Result<(), Box<dyn Error>> {
        print!("peak      {} reserved of a budget of {}", budget.peak(), budget.limit());
        self.stats["budget"] = json!({ "limit_bytes": budget.limit().0, "peak_bytes": budget.peak().0 });
        if let Some(memory) = ProcessMemory::now() {
            print!("; {} resident (VmHWM)", memory.resident_peak);
            self.stats["process"] = json!({ "resident_peak_bytes": memory.resident_peak.0 });
        }
        println!();
        if let Some(path) = &options.stats {
            let text = serde_json::to_string_pretty(&self.stats)? + "\n";
            std::fs::write(path, text)
                .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
        }
        Ok(())
    }
}

fn print_rays(report: &RenderReport) {
    let rays = &report.effects;
    println!(
        "rays      {} camera, {} shadow, {} reflection, {} transmission ({:.2} million per second)",
        grouped(rays.primary_rays),
        grouped(rays.shadow_rays + rays.shadow_segments),
        grouped(rays.reflection_rays),
        grouped(rays.transmission_rays),
        rays.rays() as f64 / report.wall_seconds.max(1e-9) / 1e6
    );
    let seconds = &report.seconds;
    println!(
        "          {:.2} s paths, {:.2} s shadows, {:.2} s shading, summed over the threads",
        seconds.paths, seconds.shadows, seconds.shading
    );
    if rays.work_cuts > 0 {
        println!("          {} rays not followed: the work budget was spent", grouped(rays.work_cuts));
    }
}

fn print_blocks(report: &RenderReport) {
    println!(
        "blocks    {} of {} touched, {} loaded ({:.2} per touched block), {} read",
        grouped(report.blocks_touched),
        grouped(report.blocks_total),
        grouped(report.trace.blocks_loaded),
        report.loads_per_touched_block(),
        Bytes(report.trace.bytes_read)
    );
    let Some(waiting) = &report.waiting else { return };
    let loaders = match waiting.loader_threads {
        0 => "loaded by the threads that trace".to_string(),
        count => format!("loaded beside them by {}", counted(count.into(), "thread")),
    };
    println!(
        "waiting   up to {} of {} rays at a time for blocks, {loaders}; {:.2} s without tracing",
        grouped(report.trace.suspended_peak),
        grouped(waiting.rays.into()),
        waiting.loading_seconds
    );
}

fn compile_stats(report: &CompileReport) -> Value {
    json!({
        "triangles": report.triangles,
        "blocks": report.blocks,
        "vertices": report.vertices,
        "file_bytes": report.file_bytes,
        "bytes_per_triangle": report.bytes_per_triangle,
        "degenerate": report.degenerate,
        "duplicates": report.duplicates,
        "skipped": report.skipped,
        "precision": format!("{:?}", report.precision),
        "error_bound": report.error_bound,
        "codec": format!("{:?}", report.codec),
        "spill_bytes": report.spill_bytes,
        "budget_peak_bytes": report.budget_peak.0,
        "seconds": phases(&report.seconds),
    })
}

fn phases(times: &PhaseSeconds) -> Value {
    json!({
        "parse": seconds(&times.parse),
        "scatter": seconds(&times.scatter),
        "cut": seconds(&times.cut),
        "encode": seconds(&times.encode),
        "write": seconds(&times.write),
        "total": seconds(&times.total),
    })
}

fn seconds(seconds: &Seconds) -> Value {
    json!({ "wall": seconds.wall, "cpu": seconds.cpu })
}

/// `1 block`, `677 blocks`.
fn counted(number: u64, noun: &str) -> String {
    format!("{} {noun}{}", grouped(number), if number == 1 { "" } else { "s" })
}

/// `1757280` as `1,757,280`.
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}
