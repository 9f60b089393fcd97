//! Queries over instances against brute force over every triangle written out in the world: same hits, same bits, same order.

mod support;

use std::ops::ControlFlow;
use std::sync::Arc;

use outcrop::error::InstanceError;
use outcrop::geom::{Affine, Precision, Ray, intersect_certified};
use outcrop::instance::{Instance, InstanceTracer, InstanceTriangle, Instances};
use outcrop::octree::{LeafLayout, OctreeOptions};
use outcrop::simd::SimdLevel;
use outcrop::trace::{MaterialSet, Occlusion};
use outcrop::units::{Bytes, MaterialId, TriangleId};
use outcrop::{BlockSource, LazyOctree, MemoryBudget};
use support::numbers::Random;
use support::{MATERIALS, Triangles, compile, occlusion_of};

/// A triangle of the world: its corners, its number in hits, its material.
type Written = ([[f64; 3]; 3], TriangleId, MaterialId);

fn is_mirrored(map: &Affine) -> bool {
    let [[a, b, c, _], [d, e, f, _], [g, h, i, _]] = map.rows();
    a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0
}

/// Every instance written out.
fn written(models: &[Triangles], instances: &[Instance]) -> Vec<Written> {
    let mut all = Vec::new();
    for (number, instance) in (0u64..).zip(instances) {
        let first = instance.model as u16 * MATERIALS;
        for (id, corners) in models[instance.model as usize].iter().enumerate() {
            let [a, b, c] = corners.map(|corner| instance.map.point(corner));
            let corners = if is_mirrored(&instance.map) { [a, c, b] } else { [a, b, c] };
            let material = MaterialId(first + id as u16 % MATERIALS);
            all.push((corners, TriangleId(number << 40 | id as u64), material));
        }
    }
    all
}

/// Every hit of a ray, in order.
fn all_hits(world: &[Written], ray: &Ray) -> Vec<(f64, TriangleId, MaterialId)> {
    let mut hits: Vec<_> = world
        .iter()
        .filter_map(|(corners, id, material)| {
            intersect_certified(ray, corners, &mut 0).map(|hit| (hit.t, *id, *material))
        })
        .collect();
    hits.sort_by(|a, b| a.partial_cmp(b).unwrap());
    hits
}

fn check(tracer: &mut InstanceTracer<'_>, world: &[Written], rays: &[Ray]) -> usize {
    let mut hits = vec![None; rays.len()];
    tracer.closest_hits(rays, &mut hits).unwrap();
    let mut occlusions = vec![Occlusion::Clear; rays.len()];
    tracer.occluded(rays, None, &mut occlusions).unwrap();
    let ignore: MaterialSet = [0, 2, 3].map(MaterialId).into_iter().collect();
    let mut filtered = vec![Occlusion::Clear; rays.len()];
    tracer.occluded(rays, Some(&ignore), &mut filtered).unwrap();
    // Every hit of every ray, but of each third one only the first two.
    let mut given = vec![Vec::new(); rays.len()];
    let most = |i: usize| if i % 3 == 2 { 2 } else { usize::MAX };
    tracer
        .all_hits(rays, |i, hit| {
            given[i].push((hit.t, hit.triangle, hit.material));
            if given[i].len() == most(i) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
        .unwrap();
    let mut found_hits = 0;
    for (i, ray) in rays.iter().enumerate() {
        let expected = all_hits(world, ray);
        assert_eq!(given[i], expected[..expected.len().min(most(i))], "ray {i}: {ray:?}");
        assert_eq!(tracer.closest_hit(ray).unwrap(), hits[i]);
        let found = hits[i].map(|hit| (hit.t, hit.triangle, hit.material));
        assert_eq!(found, expected.first().copied(), "ray {i}: {ray:?}");
        if let Some(hit) = hits[i] {
            let same = world.iter().find(|(_, id, _)| *id == hit.triangle).unwrap();
            assert_eq!(hit.vertices, same.0);
            found_hits += 1;
        }
        let blocked = if expected.is_empty() { Occlusion::Clear } else { Occlusion::Blocked };
        assert_eq!(occlusions[i], blocked, "ray {i}: {ray:?}");
        let opaque = expected.iter().any(|(.., material)| !ignore.contains(*material));
        assert_eq!(filtered[i], occlusion_of(!expected.is_empty(), opaque), "ray {i}: {ray:?}");
        // From hit to hit, coincident ones too, and past the end.
        let mut at = (-1.0, TriangleId(0));
        for step in 0..5.min(expected.len() + 1) {
            let mut next = [None];
            tracer.closest_hits_after(&[*ray], &[at], &mut next).unwrap();
            let found = next[0].map(|hit| (hit.t, hit.triangle, hit.material));
            assert_eq!(found, expected.get(step).copied(), "ray {i} step {step}: {ray:?}");
            at = expected.get(step).map_or(at, |(t, id, _)| (*t, *id));
        }
    }
    found_hits
}

/// Opens models in blocks of so many triangles and compares everything with brute force, with caches and kernels of all kinds.
fn check_everywhere(
    models: &[Triangles],
    precision: Precision,
    instances: &[Instance],
    rays: &[Ray],
) -> usize {
    let world = written(models, instances);
    let mut hits = 0;
    for (block_triangles, leaf_layout, simd, slots_max) in [
        (1300, LeafLayout::Expanded, SimdLevel::Avx2, None),
        (40, LeafLayout::Expanded, SimdLevel::Avx2, Some(2)),
        (7, LeafLayout::Indexed, SimdLevel::Portable, Some(1)),
        (40, LeafLayout::Indexed, SimdLevel::Avx2, None),
    ] {
        let sources: Vec<Arc<dyn BlockSource>> = models
            .iter()
            .map(|model| {
                let key = |i: usize| (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
                compile(model, precision, block_triangles, key) as Arc<dyn BlockSource>
            })
            .collect();
        let budget = MemoryBudget::new(Bytes::mib(256));
        let options = OctreeOptions { leaf_layout, simd: Some(simd), slots_max, ..Default::default() };
        let instances = Instances::open(&sources, instances.to_vec(), &budget, &options).unwrap();
        let share = if simd == SimdLevel::Portable { 4 } else { 1 };
        hits = hits.max(check(&mut instances.tracer().unwrap(), &world, &rays[..rays.len() / share]));
        let bounds = instances.bounds();
        for (corners, ..) in &world {
            for corner in corners {
                assert!(
                    (0..3).all(|axis| bounds.min[axis] <= corner[axis] && corner[axis] <= bounds.max[axis])
                );
            }
        }
    }
    hits
}

fn soup(random: &mut Random, count: usize, size: f64) -> Triangles {
    let triangle = |random: &mut Random| {
        let center = random.vector(1.0);
        [0; 3].map(|_| {
            let offset = random.vector(1.0);
            [0, 1, 2].map(|axis| f64::from((center[axis] + size * offset[axis]) as f32))
        })
    };
    (0..count).map(|_| triangle(random)).collect()
}

/// Rays at vertices, through edges, along axes, and free ones, from near and far.
fn rays(random: &mut Random, world: &[Written], count: usize) -> Vec<Ray> {
    (0..count)
        .map(|i| {
            let (triangle, ..) = world[random.index(world.len())];
            let corner = triangle[random.index(3)];
            let size =
                (0..3).map(|axis| (triangle[1][axis] - triangle[0][axis]).abs()).fold(1e-300, f64::max);
            let distance = size * [0.5, 3.0, 100.0, 1e6][i % 4];
            let away = random.vector(1.0);
            let origin = [0, 1, 2].map(|axis| corner[axis] + distance * away[axis]);
            let along = random.signed().abs();
            let mut ray = match i % 5 {
                0 => Ray::new(origin, random.vector(1.0)),
                1 => Ray::new(origin, [0, 1, 2].map(|axis| corner[axis] - origin[axis])),
                2 => Ray::new(
                    origin,
                    [0, 1, 2].map(|axis| {
                        triangle[0][axis] + along * (triangle[1][axis] - triangle[0][axis]) - origin[axis]
                    }),
                ),
                3 => {
                    let mut direction = [0.0; 3];
                    direction[random.index(3)] = if random.bits() & 1 == 0 { 1.0 } else { -1.0 };
                    Ray::new([0, 1, 2].map(|axis| corner[axis] - distance * direction[axis]), direction)
                }
                // Of other lengths.
                _ => Ray::new(
                    origin,
                    [0, 1, 2].map(|axis| (corner[axis] - origin[axis]) * [1e-30, 1e30][i % 2]),
                ),
            };
            if ray.direction == [0.0; 3] {
                ray.direction = [1.0, 0.0, 0.0];
            }
            if i % 7 == 0 {
                (ray.t_min, ray.t_max) = (0.2, 0.9 + random.signed().abs());
            }
            ray
        })
        .collect()
}

/// Turned, scaled by about `scale`, perhaps mirrored or sheared, and moved by about `shift`.
fn any_map(random: &mut Random, scale: f64, shift: f64, kind: usize) -> Affine {
    let turned = Affine::rotation(random.vector(1.0), 360.0 * random.signed());
    let mut factors = [0; 3].map(|_| scale * (1.0 + 0.5 * random.signed()));
    if kind % 3 == 1 {
        factors[random.index(3)] *= -1.0;
    }
    let mut map = turned.then(&Affine::scale(factors));
    if kind % 4 == 2 {
        let [x, y, _] = random.vector(0.5);
        map = map.then(&Affine::from_rows([[1.0, x, y, 0.0], [0.0, 1.0, x, 0.0], [0.0, 0.0, 1.0, 0.0]]));
    }
    map.then(&Affine::translation(random.vector(1.0).map(|x| x * shift)))
}

#[test]
fn instances_are_what_is_written_out() {
    let mut random = Random(11);
    let models = [soup(&mut random, 200, 0.2), soup(&mut random, 60, 0.5)];
    let instances: Vec<Instance> =
        (0..9).map(|i| Instance { model: i % 2, map: any_map(&mut random, 1.0, 2.0, i as usize) }).collect();
    let rays = rays(&mut random, &written(&models, &instances), 300);
    assert!(check_everywhere(&models, Precision::Float32, &instances, &rays) > 150);
}

#[test]
fn exact_maps_change_no_hit() {
    let mut random = Random(12);
    let models = [soup(&mut random, 150, 0.3)];
    let quarter = Affine::rotation([0.0, 1.0, 0.0], 90.0);
    for map in [Affine::IDENTITY, quarter, Affine::scale([-1.0, 1.0, 1.0]), Affine::scale([4.0; 3])] {
        let instances = [Instance { model: 0, map }];
        let rays = rays(&mut random, &written(&models, &instances), 150);
        assert!(check_everywhere(&models, Precision::Float32, &instances, &rays) > 70);
    }
}

#[test]
fn scales_and_distances() {
    let mut random = Random(13);
    let models = [soup(&mut random, 80, 0.3)];
    for (scale, shift) in [
        (1e-6, 1.0),
        (1e6, 1e9),
        (1.0, 1e7),
        (1e-3, 1e7),
        // Rounding moves vertices by far more than f32 resolves in the model.
        (1e-3, 1e9),
        (1e-4, 1e9),
        (1e-30, 0.0),
        (1e-60, 1e-58),
        (1e40, 1e41),
        (1e-70, 1.0),
    ] {
        let instances: Vec<Instance> =
            (0..5).map(|i| Instance { model: 0, map: any_map(&mut random, scale, shift, i) }).collect();
        let rays = rays(&mut random, &written(&models, &instances), 120);
        let hits = check_everywhere(&models, Precision::Float32, &instances, &rays);
        // At the last a model is smaller than the numbers where it stands can tell.
        assert!(hits > 40 || scale < 1e-60, "{scale} {shift}: {hits}");
    }
    // Scaled by very different factors.
    let flat = Affine::scale([1.0, 1e-5, 1e4]).then(&Affine::rotation([1.0, 2.0, 3.0], 33.0));
    let instances = [Instance { model: 0, map: flat }];
    let rays = rays(&mut random, &written(&models, &instances), 200);
    assert!(check_everywhere(&models, Precision::Float32, &instances, &rays) > 40);
}

#[test]
fn lattice_models() {
    let mut random = Random(14);
    let lattice = outcrop::geom::Lattice { exponent: -20 };
    for shift in [0.0, 1e6] {
        let snapped = |x: f64| lattice.position(lattice.quantize(x + shift).unwrap());
        let models = [soup(&mut random, 120, 0.3).into_iter().map(|t| t.map(|v| v.map(snapped))).collect()];
        let to_origin = Affine::translation([-shift; 3]);
        let instances: Vec<Instance> = (0..4)
            .map(|i| Instance { model: 0, map: to_origin.then(&any_map(&mut random, 1.0, 2.0, i)) })
            .collect();
        let rays = rays(&mut random, &written(&models, &instances), 150);
        assert!(check_everywhere(&models, Precision::Lattice(lattice), &instances, &rays) > 60);
    }
}

#[test]
fn rays_from_beyond_the_domain_hit_nothing() {
    let mut random = Random(12);
    let models = [soup(&mut random, 30, 0.5)];
    let instances =
        [0.0, 1e7, 1e12, 1e25, 1e40].map(|shift| Instance { model: 0, map: Affine::translation([shift; 3]) });
    for instance in instances {
        let mut rays = Vec::new();
        for distance in [1e77, 1e150, 1e300] {
            for (corners, ..) in written(&models, &[instance]) {
                let toward = random.vector(1.0);
                let origin = [0, 1, 2].map(|axis| corners[0][axis] - distance * toward[axis]);
                rays.push(Ray::new(origin, toward));
            }
        }
        assert_eq!(check_everywhere(&models, Precision::Float32, &[instance], &rays), 0);
    }
}

#[test]
fn equal_hits_go_to_the_first_instance() {
    let mut random = Random(15);
    let models = [soup(&mut random, 40, 0.8), soup(&mut random, 3, 0.8)];
    let map = any_map(&mut random, 1.0, 1.0, 1);
    // The same place five times, between others.
    let instances: Vec<Instance> = [1, 0, 0, 1, 0, 0, 0]
        .into_iter()
        .enumerate()
        .map(|(i, model)| Instance {
            model,
            map: if model == 0 { map } else { any_map(&mut random, 1.0, 1.0, i) },
        })
        .collect();
    let rays = rays(&mut random, &written(&models, &instances), 100);
    assert!(check_everywhere(&models, Precision::Float32, &instances, &rays) > 50);
}

/// A plate of squares, its edges on whole numbers: instances beside each other share their borders, turned ones too.
#[test]
fn nothing_leaks_inside_or_between_instances() {
    let mut plate = Triangles::new();
    for x in 0..4 {
        for y in 0..4 {
            let p = |i: i32, j: i32| [f64::from(x + i - 2), f64::from(y + j - 2), 0.0];
            plate.push([p(0, 0), p(1, 0), p(1, 1)]);
            plate.push([p(0, 0), p(1, 1), p(0, 1)]);
        }
    }
    let models = [plate];
    let mut random = Random(16);
    let instances: Vec<Instance> = (0..9)
        .map(|i| {
            let at = [f64::from(4 * (i % 3)), f64::from(4 * (i / 3)), 0.0];
            let turned = Affine::rotation([0.0, 0.0, 1.0], 90.0 * f64::from(i));
            let mirrored = if i % 2 == 0 { Affine::IDENTITY } else { Affine::scale([1.0, -1.0, 1.0]) };
            Instance { model: 0, map: mirrored.then(&turned).then(&Affine::translation(at)) }
        })
        .collect();
    let mut rays = Vec::new();
    for _ in 0..400 {
        // Through borders of squares and of plates, and their corners, at any angle.
        let at =
            [(random.signed() * 20.0).round() / 4.0 + 4.0, (random.signed() * 20.0).round() / 4.0 + 4.0, 0.0];
        let from = random.vector(1.0);
        let origin = [at[0] + 3.0 * from[0], at[1] + 3.0 * from[1], 1.0 + from[2].abs()];
        rays.push(Ray::new(origin, [0, 1, 2].map(|axis| at[axis] - origin[axis])));
    }
    let inside = |ray: &&Ray| {
        let at = ray.at(1.0);
        (0..2).all(|axis| at[axis] > -1.99 && at[axis] < 9.99)
    };
    let count = rays.iter().filter(inside).count();
    assert!(check_everywhere(&models, Precision::Float32, &instances, &rays) >= count);
    // Every plate turned by an odd angle: nothing leaks inside.
    let map = Affine::rotation([1.0, 2.0, -0.5], 37.0).then(&Affine::translation([0.1, 1e3, -7.0]));
    let turned: Vec<Ray> = (0..300)
        .map(|_| {
            let at = map.point([
                (random.signed() * 7.9).round() / 4.0,
                (random.signed() * 7.9).round() / 4.0,
                0.0,
            ]);
            let from = random.vector(1.0);
            Ray::new([0, 1, 2].map(|axis| at[axis] + from[axis]), from.map(|x| -x))
        })
        .collect();
    check_everywhere(&models, Precision::Float32, &[Instance { model: 0, map }], &turned);
}

#[test]
fn frames_of_a_moving_scene_share_their_blocks() {
    let mut random = Random(17);
    let models = [soup(&mut random, 400, 0.1)];
    let budget = MemoryBudget::new(Bytes::mib(64));
    let source = compile(&models[0], Precision::Float32, 40, |i| models[0][i][0][0].to_bits() >> 40);
    let sources = [source as Arc<dyn BlockSource>];
    let placed = |random: &mut Random| -> Vec<Instance> {
        (0..6).map(|i| Instance { model: 0, map: any_map(random, 1.0, 1.5, i) }).collect()
    };
    let first = placed(&mut random);
    let mut instances = Instances::open(&sources, first, &budget, &OctreeOptions::default()).unwrap();
    let used = budget.used();
    let mut loads = Vec::new();
    for frame in 0..3 {
        if frame > 0 {
            instances.place(placed(&mut random)).unwrap();
        }
        let world = written(&models, instances.instances());
        let rays = rays(&mut random, &world, 200);
        let mut tracer = instances.tracer().unwrap();
        check(&mut tracer, &world, &rays);
        loads.push(tracer.counters().blocks_loaded);
    }
    assert_eq!(loads, [10, 0, 0], "each block once, in the first frame");
    assert_eq!(instances.octrees()[0].blocks_touched(), 10);
    assert_eq!(budget.used(), used);
}

/// Rays of all times between opening and closing of the shutter, each against what is there at its time.
#[test]
fn moving_instances_are_where_the_time_of_a_ray_says() {
    let mut random = Random(23);
    let models = [soup(&mut random, 120, 0.3)];
    let budget = MemoryBudget::new(Bytes::mib(64));
    let source = compile(&models[0], Precision::Float32, 40, |i| i as u64) as Arc<dyn BlockSource>;
    let starts: Vec<Instance> =
        (0..6).map(|i| Instance { model: 0, map: any_map(&mut random, 1.0, 2.0, i) }).collect();
    let mut instances =
        Instances::open(&[source], starts.clone(), &budget, &OctreeOptions::default()).unwrap();
    // Half of them move and turn; two of those grow as well, so that their vertices go straight.
    let ends: Vec<(usize, Affine)> = (0..6)
        .step_by(2)
        .map(|number| {
            let shift = Affine::translation(random.vector(1.0));
            if number == 4 {
                let turn = Affine::rotation(random.vector(1.0), 150.0);
                return (number, starts[number].map.then(&turn).then(&shift));
            }
            let turn = Affine::rotation(random.vector(1.0), 40.0 * random.signed());
            (number, turn.then(&Affine::scale([1.1, 0.9, 1.2])).then(&starts[number].map).then(&shift))
        })
        .collect();
    assert!(!instances.are_moving());
    instances.move_while_open(&ends).unwrap();
    assert!(instances.are_moving());
    let mut tracer = instances.tracer().unwrap();
    let (mut hits, mut moved) = (0, 0);
    for turn in 0..40 {
        let time = [0.0, 1.0, random.unit()][turn % 3];
        let mut now = starts.clone();
        for (number, end) in &ends {
            now[*number].map = starts[*number].map.between(end, time);
        }
        let world = written(&models, &now);
        let rays = rays(&mut random, &world, 20);
        let mut found = vec![None; rays.len()];
        tracer.at_times(vec![time; rays.len()]);
        tracer.closest_hits(&rays, &mut found).unwrap();
        let mut occlusions = vec![Occlusion::Clear; rays.len()];
        tracer.at_times(vec![time; rays.len()]);
        tracer.occluded(&rays, None, &mut occlusions).unwrap();
        let mut given = vec![Vec::new(); rays.len()];
        tracer.at_times(vec![time; rays.len()]);
        tracer
            .all_hits(&rays, |index, hit| {
                given[index].push((hit.t, hit.triangle, hit.material));
                ControlFlow::Continue(())
            })
            .unwrap();
        // Without times all are at the opening.
        let mut at_rest = vec![None; rays.len()];
        tracer.closest_hits(&rays, &mut at_rest).unwrap();
        for (index, ray) in rays.iter().enumerate() {
            let expected = all_hits(&world, ray);
            let hit = found[index].map(|hit| (hit.t, hit.triangle, hit.material));
            assert_eq!(hit, expected.first().copied(), "{time}: {ray:?}");
            assert_eq!(given[index], expected, "{time}: {ray:?}");
            assert_eq!(occlusions[index] == Occlusion::Blocked, !expected.is_empty());
            hits += usize::from(hit.is_some());
            moved += usize::from(found[index] != at_rest[index]);
            let first = all_hits(&written(&models, &starts), ray);
            assert_eq!(at_rest[index].map(|hit| (hit.t, hit.triangle, hit.material)), first.first().copied());
        }
    }
    assert!(hits > 400 && moved > 100, "{hits} {moved}");
    // Times beyond the shutter's are those at its ends: nothing leaves the boxes that were made for its way.
    let mut last = starts.clone();
    ends.iter().for_each(|(number, end)| last[*number].map = starts[*number].map.between(end, 1.0));
    for (time, at) in [(-3.0, &starts), (5.0, &last), (f64::INFINITY, &last), (f64::NAN, &starts)] {
        let world = written(&models, at);
        let rays = rays(&mut random, &world, 20);
        let mut found = vec![None; rays.len()];
        tracer.at_times(vec![time; rays.len()]);
        tracer.closest_hits(&rays, &mut found).unwrap();
        for (ray, hit) in rays.iter().zip(found) {
            let hit = hit.map(|hit| (hit.t, hit.triangle, hit.material));
            assert_eq!(hit, all_hits(&world, ray).first().copied(), "{time}: {ray:?}");
        }
    }
    drop(tracer);
    // What turns over or shrinks to nothing is refused, and the next frame is at rest.
    for bad in [starts[0].map.then(&Affine::scale([-1.0, 1.0, 1.0])), Affine::scale([0.0; 3])] {
        let refused = instances.move_while_open(&[(0, bad)]);
        assert!(matches!(refused, Err(InstanceError::Instance { instance: 0, .. })));
    }
    assert!(instances.move_while_open(&[(6, Affine::IDENTITY)]).is_err());
    instances.place(starts).unwrap();
    assert!(!instances.are_moving());
}

#[test]
fn frames_need_no_memory_beside_what_the_first_took() {
    let mut random = Random(23);
    let budget = MemoryBudget::new(Bytes::mib(64));
    let source = compile(&soup(&mut random, 120, 0.3), Precision::Float32, 40, |i| i as u64);
    let frame = |count: i32, height: f64| -> Vec<Instance> {
        let at = |i| Affine::translation([3.0 * f64::from(i), height, 0.0]);
        (0..count).map(|i| Instance { model: 0, map: at(i) }).collect()
    };
    let sources = [source as Arc<dyn BlockSource>];
    let mut instances =
        Instances::open(&sources, frame(200, 0.0), &budget, &OctreeOptions::default()).unwrap();
    let first = budget.used();
    // Of a model that is larger than memory the cache has all that is left.
    let rest = budget.reserve(budget.available(), "all else").unwrap();
    for height in [1.0, 2.0, 3.0] {
        instances.place(frame(200, height)).unwrap();
        for shift in [1.0, 9.0] {
            instances.move_while_open(&[(7, Affine::translation([21.0, height + shift, 0.0]))]).unwrap();
            assert!(instances.are_moving() && instances.bounds().max[1] > height + shift);
        }
    }
    // More than there is room for: the frame stays.
    assert!(matches!(instances.place(frame(201, 0.0)), Err(InstanceError::Budget(_))));
    assert!(instances.instances().len() == 200 && instances.are_moving());
    drop(rest);
    instances.place(frame(201, 0.0)).unwrap();
    assert!(budget.used() > first);
    instances.place(frame(20, 0.0)).unwrap();
    assert!(budget.used() < first);
    drop(instances);
    assert_eq!(budget.used(), Bytes(0));
}

#[test]
fn senseless_instances_are_refused() {
    let mut random = Random(18);
    let budget = MemoryBudget::new(Bytes::mib(64));
    let source = compile(&soup(&mut random, 20, 0.3), Precision::Float32, 40, |_| 0);
    let sources = [source as Arc<dyn BlockSource>];
    let open = |instances| Instances::open(&sources, instances, &budget, &OctreeOptions::default());
    let bad = [
        Affine::scale([1.0, 0.0, 1.0]),
        Affine::scale([f64::NAN, 1.0, 1.0]),
        Affine::translation([f64::INFINITY, 0.0, 0.0]),
        Affine::scale([1e100; 3]),
        Affine::from_rows([[1.0, 2.0, 0.0, 0.0], [2.0, 4.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
    ];
    let good = Instance { model: 0, map: Affine::IDENTITY };
    for map in bad {
        let refused = open(vec![good, Instance { model: 0, map }]);
        assert!(matches!(refused, Err(InstanceError::Instance { instance: 1, .. })), "{map:?}");
    }
    assert!(matches!(
        open(vec![Instance { model: 1, ..good }]),
        Err(InstanceError::Instance { instance: 0, .. })
    ));
    let mut kept = open(vec![good]).unwrap();
    assert!(kept.place(vec![Instance { model: 7, ..good }]).is_err());
    assert_eq!(kept.instances(), [good]);
    // None at all is a scene without anything.
    kept.place(vec![]).unwrap();
    assert!(kept.bounds().is_empty());
    let ray = Ray::new([5.0; 3], [-1.0; 3]);
    let mut hits = [None];
    kept.tracer().unwrap().closest_hits(&[ray], &mut hits).unwrap();
    assert_eq!(hits, [None]);
    drop(kept);
    assert_eq!(budget.used(), Bytes(0));
    let number = InstanceTriangle { instance: 5, triangle: TriangleId(9) };
    assert_eq!(InstanceTriangle::of(TriangleId(5 << 40 | 9)), number);
}

#[test]
fn many_models_share_a_small_budget() {
    let mut random = Random(19);
    let models: Vec<Triangles> = [600, 30, 300].map(|count| soup(&mut random, count, 0.1)).to_vec();
    let instances: Vec<Instance> =
        (0..12).map(|i| Instance { model: i % 3, map: any_map(&mut random, 1.0, 2.0, i as usize) }).collect();
    let sources: Vec<Arc<dyn BlockSource>> = models
        .iter()
        .map(|model| compile(model, Precision::Float32, 20, |i| i as u64) as Arc<dyn BlockSource>)
        .collect();
    let world = written(&models, &instances);
    let rays = rays(&mut random, &world, 100);
    let mut opened = 0;
    for kib in (512..24 << 10).step_by(512) {
        let budget = MemoryBudget::new(Bytes::kib(kib));
        let Ok(instances) = Instances::open(&sources, instances.clone(), &budget, &OctreeOptions::default())
        else {
            assert_eq!(budget.used(), Bytes(0));
            continue;
        };
        opened += 1;
        if opened % 8 == 1 {
            check(&mut instances.tracer().unwrap(), &world, &rays);
        }
        assert!(budget.peak() <= budget.limit());
    }
    assert!(opened > 10, "{opened}");
}

/// The cache of one model must not take what another one's tracers need.
#[test]
fn tracers_have_room_beside_caches_that_are_too_small() {
    let mut random = Random(20);
    let sources: Vec<Arc<dyn BlockSource>> = (0..3)
        .map(|_| {
            let model = soup(&mut random, 3000, 0.1);
            compile(&model, Precision::Float32, 20, |i| i as u64) as Arc<dyn BlockSource>
        })
        .collect();
    let places: Vec<Instance> = (0..3).map(|model| Instance { model, map: Affine::IDENTITY }).collect();
    let options = OctreeOptions { tracers_max: 4, ..Default::default() };
    let mut too_small = 0;
    for kib in (512..16 << 10).step_by(128) {
        let budget = MemoryBudget::new(Bytes::kib(kib));
        let Ok(instances) = Instances::open(&sources, places.clone(), &budget, &options) else { continue };
        let is_too_small =
            |octree: &LazyOctree| octree.cache().slot_count() < octree.model().block_id_count();
        too_small += u32::from(instances.octrees().iter().any(is_too_small));
        let tracers: Vec<_> = (0..4).map(|_| instances.tracer()).collect();
        let failed = tracers.iter().find_map(|tracer| tracer.as_ref().err());
        assert!(failed.is_none(), "{kib} KiB: {failed:?}");
    }
    assert!(too_small > 10, "{too_small}");
}
