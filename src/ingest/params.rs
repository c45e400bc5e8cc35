//! Settings of the ingest stage.

/// Where the camera's pose comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PoseSource {
    /// The first that gives a pose, tried in the order TF, pose topic, odometry; then kept.
    #[default]
    Auto,
    /// `/tf` and `/tf_static`.
    Tf,
    /// A `PoseStamped` or `PoseWithCovarianceStamped` topic.
    Pose,
    /// An `Odometry` topic.
    Odom,
}

/// What a stream may at most make ingest hold. What goes beyond is refused and counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IngestLimits {
    /// Pixels of an image, ≥ 1.
    pub image_px: usize,
    /// Vertices of the mesh, all blocks together, ≥ 1.
    pub mesh_vertices: usize,
    /// Triangles of the mesh, all blocks together, ≥ 1.
    pub mesh_triangles: usize,
    /// Blocks of the mesh, ≥ 1.
    pub mesh_blocks: usize,
    /// Frames of the transform tree, ≥ 1.
    pub tf_frames: usize,
    /// Transforms kept of one moving frame, ≥ 2.
    pub tf_samples: usize,
    /// Poses of one message of corrections, ≥ 1.
    pub corrections: usize,
    /// How much is noted of what was refused.
    pub report: ReportLimits,
}

/// How much is noted of what was refused; the counts miss nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReportLimits {
    /// Reasons kept apart for one topic, ≥ 1; rarer ones are counted together.
    pub reasons: usize,
    /// Examples kept of each reason.
    pub examples: usize,
}

impl Default for ReportLimits {
    fn default() -> Self {
        Self {
            reasons: 24,
            examples: 3,
        }
    }
}

impl Default for IngestLimits {
    fn default() -> Self {
        Self {
            image_px: 1 << 26,
            mesh_vertices: 20_000_000,
            mesh_triangles: 20_000_000,
            mesh_blocks: 1_000_000,
            tf_frames: 1 << 12,
            tf_samples: 1 << 14,
            corrections: 100_000,
            report: ReportLimits::default(),
        }
    }
}

/// Settings of synchronisation, pose lookup and mesh assembly.
#[derive(Clone, Debug, PartialEq)]
pub struct IngestParams {
    /// Whether colour and depth may differ in stamp; otherwise only equal stamps pair.
    pub approx_sync: bool,
    /// Largest difference of the stamps of a pair, seconds, ≥ 0. Two free-running 30 Hz streams
    /// are at most 0.0167 s apart.
    pub approx_sync_max_interval_s: f64,
    /// Most colour, and most depth, images that wait for a partner, ≥ 1; the oldest is dropped.
    pub sync_queue_size: usize,
    /// Most messages of one topic that wait to be read (live sources), ≥ 1.
    pub topic_queue_size: usize,
    /// How long a frame or a mesh waits for its transform, seconds of stream time, ≥ 0.
    pub wait_for_transform_s: f64,
    /// Most synchronised frames that wait for a pose, ≥ 1; the oldest must then do with the
    /// transforms that have arrived.
    pub pose_queue_size: usize,
    /// Optical frame of the colour camera; `None`: the `frame_id` of the colour images.
    pub camera_frame_id: Option<String>,
    /// The world frame; `None`: the mesh's frame, or the root above the camera when no mesh came
    /// before the first pose was needed.
    pub map_frame_id: Option<String>,
    /// Where the camera's pose comes from.
    pub pose_source: PoseSource,
    /// The frame whose pose the pose topic gives; `None`: the colour camera's optical frame.
    pub pose_frame_id: Option<String>,
    /// How long transforms are kept, seconds, > 0 and at least `wait_for_transform_s`.
    pub tf_buffer_s: f64,
    /// How far before the first or past the last transform a stamp may lie, seconds, ≥ 0; the
    /// nearest transform is then taken as it is, once waiting is over.
    pub max_extrapolation_s: f64,
    /// Longest gap between two transforms that is interpolated when they differ by more than a
    /// hand's tremor, seconds, > 0.
    pub max_interpolation_gap_s: f64,
    /// A stream whose stamps fall back by more than this, seconds, > 0, twice in a row has
    /// restarted its clock.
    pub clock_jump_back_s: f64,
    /// What the stream may at most make ingest hold.
    pub limits: IngestLimits,
}

impl Default for IngestParams {
    fn default() -> Self {
        Self {
            approx_sync: true,
            approx_sync_max_interval_s: 0.02,
            sync_queue_size: 10,
            topic_queue_size: 5,
            wait_for_transform_s: 1.0,
            pose_queue_size: 64,
            camera_frame_id: None,
            map_frame_id: None,
            pose_source: PoseSource::Auto,
            pose_frame_id: None,
            tf_buffer_s: 10.0,
            max_extrapolation_s: 0.01,
            max_interpolation_gap_s: 0.5,
            clock_jump_back_s: 1.0,
            limits: IngestLimits::default(),
        }
    }
}
