//! What a worker's engine takes from its queue.

use super::*;
use crate::access::BlockSketch;
use crate::cluster::{LeasedCells, Message, RoleOptions};
use crate::scene::{Camera, Scene};
use crate::transport::LocalNetwork;
use crate::units::Bytes;
use crate::without_threads::without_threads;

#[test]
fn a_worker_that_gets_no_thread_says_so() {
    without_threads("cluster::drive::tests::a_worker_that_gets_no_thread_says_so", || {
        let network = LocalNetwork::new();
        let control = network.open("worker");
        let data: Arc<dyn Transport> = Arc::new(network.open("data"));
        let options = WorkerOptions::new("worker", MemoryBudget::new(Bytes::mib(64)));
        let stop = AtomicBool::new(false);
        let result = run_worker(&control, &data, "coordinator", &options, &stop, &mut |_| {});
        assert!(matches!(result, Err(NodeError::CannotRender { .. })), "{result:?}");
    });
}

#[test]
fn what_lanes_of_another_job_left_in_the_queue_is_not_taken_for_this_ones() {
    let network = LocalNetwork::new();
    let (hub, control) = (network.open("coordinator"), network.open("worker"));
    let (events_in, events) = mpsc::sync_channel(16);
    let (notes_in, notes) = mpsc::channel();
    let (stop, roles) = (AtomicBool::new(false), RoleOptions::default());
    let mut engine = Engine {
        worker: Worker::new("worker", 1, None, roles),
        reconnect: Reconnect::new(&control, "coordinator", Duration::from_secs(60), roles),
        control: &control,
        events,
        job: 2,
        start: Instant::now(),
        stop: &stop,
        log: &mut |_| {},
        waiting: VecDeque::new(),
        readers: Vec::new(),
        copied: None,
        notes_in,
        notes,
    };
    engine.turn().unwrap();
    let Some(TransportEvent::Connected { peer, .. }) = hub.receive(Duration::from_secs(10)).unwrap() else {
        panic!("the worker did not connect");
    };
    let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
    let job = Job::new(Scene::new(camera), RenderSettings::new(128, 64), 7);
    let what = LeasedCells { lease: 1, tile: 0, cells: u64::MAX };
    let assign = Message::Assign { lane: 0, what, stop_after_us: u64::MAX };
    for message in [Message::Job(Box::new(job)), assign] {
        hub.send(peer, message.frame()).unwrap();
        let event = control.receive(Duration::from_secs(10)).unwrap().unwrap();
        events_in.send((None, WorkerEvent::Network(event))).unwrap();
        engine.turn().unwrap();
    }
    engine.handle(WorkerEvent::Opened);
    let is_render = |action: &WorkerAction| match action {
        WorkerAction::Render { region, .. } => Some(*region),
        _ => None,
    };
    let region = engine.waiting.iter().find_map(is_render).unwrap();
    let rendered = || WorkerEvent::Rendered {
        lane: 0,
        // The same size in every job: nothing but the number tells them apart.
        pixels: vec![[0.5; 3]; region.pixels() as usize],
        time: Duration::from_millis(1),
        work: 1.0,
        blocks: BlockSketch::default(),
    };
    for event in [rendered(), WorkerEvent::Failed { reason: "the other job".to_owned() }] {
        events_in.send((Some(1), event)).unwrap();
        engine.turn().unwrap();
        assert_eq!((engine.worker.counters().cells, engine.worker.failure()), (0, None));
    }
    events_in.send((Some(2), rendered())).unwrap();
    engine.turn().unwrap();
    assert_eq!(engine.worker.counters().cells * 64, region.pixels());
}
