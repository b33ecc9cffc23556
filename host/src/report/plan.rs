//! Summary and HTML report of a plan file.

use std::fmt::Write as _;
use std::time::Duration;

use nalgebra::{Matrix2, Vector3};

use super::chart::{COLOURS, Chart, Curve, escape};
use crate::flight::{FlightModel, landing};
use crate::plan::file::PlanFile;
use crate::plan::throw::{Arm, JOINTS};
use crate::verify::{self, motion};

/// A few lines for the terminal.
#[must_use]
pub fn summary(plan: &PlanFile, took: Duration) -> String {
    let [x, y, z] = plan.target.position_m;
    let l = &plan.landing;
    let covariance = Matrix2::new(
        l.covariance_m2[0][0],
        l.covariance_m2[0][1],
        l.covariance_m2[1][0],
        l.covariance_m2[1][1],
    );
    let (a, b, _) = landing::ellipse(&covariance);
    let speed = Vector3::from(plan.release.velocity_m_s).norm();
    let [dx, dy] = l.delay_sensitivity_mm_per_ms;
    let mut out = format!(
        "throw to ({x}, {y}, {z}) m: J = {:.4} (time {:.2}, braking {:.2}, jerk {:.2})\n",
        plan.objective.value, plan.objective.time, plan.objective.braking, plan.objective.jerk
    );
    let _ = writeln!(
        out,
        "  release after {:.3} s of {:.3} s at {speed:.2} m/s, flight {:.3} s",
        plan.release_time_s, plan.end_time_s, l.flight_s
    );
    let _ = writeln!(
        out,
        "  landing 1σ {:.1} × {:.1} mm; a late release shifts it by {:.2} mm per ms",
        a * 1e3,
        b * 1e3,
        dx.hypot(dy)
    );
    if let Some(p) = l.hit_probability {
        let _ = writeln!(out, "  probability of a hit {:.1} %", p * 100.0);
    }
    let share = |v: &[f64]| v.iter().copied().fold(f64::INFINITY, f64::min) * 100.0;
    let m = &plan.margins;
    let _ = writeln!(
        out,
        "  least margin: position {:.3} rad, speed {:.0} %, acceleration {:.0} %, jerk {:.0} %{}",
        m.position_rad.iter().copied().fold(f64::INFINITY, f64::min),
        share(&m.speed_share),
        share(&m.acceleration_share),
        share(&m.jerk_share),
        m.clearance_m.map_or_else(String::new, |c| format!(", clearance {:.1} mm", c * 1e3)),
    );
    for s in &plan.currents.supply_peak {
        let _ = writeln!(out, "  supply \"{}\": peak {:.1} A of {:.0} A", s.name, s.peak_a, s.limit_a);
    }
    let _ = writeln!(
        out,
        "  {} of {} starts ended in a throw, {:.1} ms",
        plan.search.solved,
        plan.search.starts,
        took.as_secs_f64() * 1e3
    );
    out
}

/// One self-contained HTML file.
#[must_use]
pub fn html(arm: &Arm, plan: &PlanFile) -> String {
    let [x, y, z] = plan.target.position_m;
    let mut body = format!(
        "<h1>Throw to ({x}, {y}, {z}) m</h1><p>{} · form {:?} · J = {:.4} · release at {:.3} s of {:.3} s</p>",
        escape(&plan.robot.name),
        plan.search.form,
        plan.objective.value,
        plan.release_time_s,
        plan.end_time_s
    );
    body += "<section class=\"wide\"><h2>Hand path and flight</h2><canvas id=\"scene\" width=\"1100\" height=\"560\"></canvas><p class=\"k\">Drag to turn, wheel to zoom, slider for time.</p><input id=\"time\" type=\"range\" min=\"0\" max=\"1000\" value=\"0\" aria-label=\"time\"></section><div class=\"grid\">";
    for chart in joint_charts(arm, plan) {
        let _ = write!(body, "<figure>{}</figure>", chart.svg());
    }
    for chart in current_charts(arm, plan) {
        let _ = write!(body, "<figure>{}</figure>", chart.svg());
    }
    let _ = write!(body, "<figure>{}</figure>", ellipse_chart(plan).svg());
    body += "</div><section class=\"wide\"><h2>Checks by other means</h2><table><tr><th></th><th>what</th><th>worst</th><th>at</th></tr>";
    for f in verify::check(arm, plan).findings {
        let (mark, class) = match (f.ok, f.enforced) {
            (true, _) => ("holds", "ok"),
            (false, true) => ("FAILS", "bad"),
            (false, false) => ("not claimed", "note"),
        };
        let at = f.at_s.map_or_else(String::new, |t| format!("{t:.3} s"));
        let _ = write!(
            body,
            "<tr class=\"{class}\"><td>{mark}</td><td>{}</td><td>{}</td><td>{at}</td></tr>",
            escape(&f.what),
            escape(&f.worst)
        );
    }
    body += "</table></section>";
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Throw</title><style>{STYLE}</style>{body}<script>const scene={};{SCRIPT}</script></html>\n",
        scene(arm, plan)
    )
}

fn times(plan: &PlanFile, count: u32) -> Vec<f64> {
    (0..=count).map(|i| plan.end_time_s * f64::from(i) / f64::from(count)).collect()
}

fn release_mark(plan: &PlanFile) -> Option<(f64, String)> {
    Some((plan.release_time_s, "release".to_owned()))
}

/// Positions in their ranges, and speed, acceleration and jerk as shares of their limits.
fn joint_charts(arm: &Arm, plan: &PlanFile) -> Vec<Chart> {
    let t = times(plan, 200);
    let samples: Vec<_> = t.iter().map(|t| motion::at(plan, *t)).collect();
    let limit = |y: f64| Curve {
        name: String::new(),
        colour: "#444",
        points: vec![(0.0, y), (plan.end_time_s, y)],
        dashed: true,
    };
    let chart =
        |title: &str, y_label: &str, value: &dyn Fn(&motion::Sample, usize) -> f64, limits: &[f64]| {
            let mut curves: Vec<Curve> = (0..JOINTS)
                .map(|j| Curve {
                    name: arm.joints()[j].name.clone(),
                    colour: COLOURS[j],
                    points: t.iter().zip(&samples).map(|(t, s)| (*t, value(s, j))).collect(),
                    dashed: false,
                })
                .collect();
            curves.extend(limits.iter().map(|y| limit(*y)));
            Chart {
                title: title.to_owned(),
                x_label: "time in s".to_owned(),
                y_label: y_label.to_owned(),
                curves,
                mark: release_mark(plan),
                equal: false,
            }
        };
    let l = |j: usize| arm.joints()[j].limits;
    vec![
        chart(
            "Positions within their ranges",
            "0 lower end, 1 upper end",
            &|s, j| (s.q[j] - l(j).q_min_rad) / (l(j).q_max_rad - l(j).q_min_rad),
            &[0.0, 1.0],
        ),
        chart("Speeds", "share of the limit", &|s, j| s.qd[j] / l(j).v_max_rad_s, &[-1.0, 1.0]),
        chart("Accelerations", "share of the limit", &|s, j| s.qdd[j] / l(j).a_max_rad_s2, &[-1.0, 1.0]),
        chart("Jerks", "share of the limit", &|s, j| s.jerk[j] / l(j).j_max_rad_s3, &[-1.0, 1.0]),
    ]
}

fn current_charts(arm: &Arm, plan: &PlanFile) -> Vec<Chart> {
    let t = times(plan, 200);
    let motor: Option<Vec<_>> = t
        .iter()
        .map(|t| {
            let s = motion::at(plan, *t);
            arm.motor_currents(&s.qd, &arm.inverse_dynamics(&s.q, &s.qd, &s.qdd))
        })
        .collect();
    let Some(motor) = motor else { return Vec::new() };
    arm.supplies()
        .iter()
        .map(|supply| {
            let mut curves = vec![
                Curve {
                    name: "sum".to_owned(),
                    colour: "#000",
                    points: t
                        .iter()
                        .zip(&motor)
                        .map(|(t, i)| (*t, (0..JOINTS).filter(|j| supply.feeds[*j]).map(|j| i[j]).sum()))
                        .collect(),
                    dashed: false,
                },
                Curve {
                    name: "limit".to_owned(),
                    colour: "#444",
                    points: vec![(0.0, supply.current_max_a), (plan.end_time_s, supply.current_max_a)],
                    dashed: true,
                },
            ];
            curves.extend((0..JOINTS).filter(|j| supply.feeds[*j]).map(|j| Curve {
                name: arm.joints()[j].name.clone(),
                colour: COLOURS[j],
                points: t.iter().zip(&motor).map(|(t, i)| (*t, i[j])).collect(),
                dashed: false,
            }));
            Chart {
                title: format!("Currents of supply \"{}\"", supply.name),
                x_label: "time in s".to_owned(),
                y_label: "current in A".to_owned(),
                curves,
                mark: release_mark(plan),
                equal: false,
            }
        })
        .collect()
}

fn ellipse_chart(plan: &PlanFile) -> Chart {
    let l = &plan.landing;
    let c = Matrix2::new(
        l.covariance_m2[0][0],
        l.covariance_m2[0][1],
        l.covariance_m2[1][0],
        l.covariance_m2[1][1],
    );
    let (a, b, angle) = landing::ellipse(&c);
    let (sin, cos) = angle.sin_cos();
    let aim = plan.target.position_m;
    let ring = |k: f64| -> Vec<(f64, f64)> {
        (0..=72)
            .map(|i| {
                let (s, co) = (f64::from(i) * std::f64::consts::TAU / 72.0).sin_cos();
                let (u, v) = (k * a * co, k * b * s);
                (
                    (l.mean_m[0] - aim[0] + u * cos - v * sin) * 1e3,
                    (l.mean_m[1] - aim[1] + u * sin + v * cos) * 1e3,
                )
            })
            .collect()
    };
    let cross = 2.0;
    Chart {
        title: "Landing about the target".to_owned(),
        x_label: "x in mm".to_owned(),
        y_label: "y in mm".to_owned(),
        curves: vec![
            Curve { name: "1σ".to_owned(), colour: COLOURS[0], points: ring(1.0), dashed: false },
            Curve { name: "2σ".to_owned(), colour: COLOURS[0], points: ring(2.0), dashed: true },
            Curve {
                name: "target".to_owned(),
                colour: COLOURS[1],
                points: vec![(-cross, 0.0), (cross, 0.0), (0.0, 0.0), (0.0, cross), (0.0, -cross)],
                dashed: false,
            },
        ],
        mark: None,
        equal: true,
    }
}

/// What the picture in space shows: boxes of the arm at some instants, the path of the ball in the hand, the flight.
fn scene(arm: &Arm, plan: &PlanFile) -> String {
    let point = |p: &Vector3<f64>| format!("[{:.4},{:.4},{:.4}]", p.x, p.y, p.z);
    let list =
        |points: &[Vector3<f64>]| format!("[{}]", points.iter().map(point).collect::<Vec<_>>().join(","));
    let mut steps = Vec::new();
    let mut hand = Vec::new();
    let landed_s = plan.release_time_s + plan.landing.flight_s;
    let last_s = plan.end_time_s.max(landed_s);
    let count = 60;
    let flight = FlightModel::vacuum(plan.landing.gravity_m_s2)
        .and_then(|f| f.with_drag(plan.landing.drag_per_m))
        .and_then(|f| f.with_magnus(Vector3::from(plan.landing.magnus_rad_s)));
    let (p0, v0) = (Vector3::from(plan.release.position_m), Vector3::from(plan.release.velocity_m_s));
    let ball_at = |t: f64, held: Vector3<f64>| match &flight {
        Ok(f) if t > plan.release_time_s => {
            f.fly(&p0, &v0, (t - plan.release_time_s).min(plan.landing.flight_s)).p
        }
        _ => held,
    };
    for i in 0..=count {
        let t = last_s * f64::from(i) / f64::from(count);
        let frames = arm.fk(&motion::at(plan, t.min(plan.end_time_s)).q);
        let held = arm.ball(&frames).pos;
        hand.push(held);
        let boxes: Vec<String> = arm
            .collision()
            .boxes()
            .iter()
            .map(|b| {
                let x = b.link.checked_sub(1).map_or(b.x_lb, |i| frames.x_w[i] * b.x_lb);
                let corners: Vec<Vector3<f64>> = (0..8_u8)
                    .map(|k| {
                        let sign = |bit: u8| if k & bit == 0 { -1.0 } else { 1.0 };
                        x.transform_point(&Vector3::new(sign(1), sign(2), sign(4)).component_mul(&b.half_m))
                    })
                    .collect();
                list(&corners)
            })
            .collect();
        steps.push(format!(
            "{{\"t\":{t:.4},\"ball\":{},\"boxes\":[{}]}}",
            point(&ball_at(t, held)),
            boxes.join(",")
        ));
    }
    let flown: Vec<Vector3<f64>> = (0..=40)
        .map(|i| ball_at(plan.release_time_s + 1e-9 + plan.landing.flight_s * f64::from(i) / 40.0, p0))
        .collect();
    format!(
        "{{\"floor\":{},\"target\":{},\"hand\":{},\"flight\":{},\"steps\":[{}]}}",
        arm.world().floor_z_m,
        point(&Vector3::from(plan.target.position_m)),
        list(&hand),
        list(&flown),
        steps.join(",")
    )
}

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;margin:24px auto;max-width:1180px;padding:0 16px;color:#111;background:#fff}h1{font-size:22px;margin:0}h2{font-size:16px}.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(480px,1fr));gap:12px}figure{margin:0;border:1px solid #ddd;padding:6px}svg{width:100%;height:auto}canvas{width:100%;border:1px solid #ddd;touch-action:none}input{width:100%}.t{font-size:14px;font-weight:600}.k{font-size:11px;fill:#333;color:#333}.g{stroke:#e4e4e4;fill:none}.m{stroke:#999;stroke-dasharray:2 3;fill:none}.c{fill:none;stroke-width:1.6}table{border-collapse:collapse}td,th{padding:3px 10px;border-bottom:1px solid #ddd;text-align:left}.bad td:first-child{color:#b00;font-weight:700}.ok td:first-child{color:#070}.note td:first-child{color:#777}";

const SCRIPT: &str = r##"
const canvas=document.getElementById('scene'),g=canvas.getContext('2d'),slider=document.getElementById('time');
let az=Math.atan2(scene.target[1],scene.target[0])+0.35,el=0.25,zoom=1.25,drag=null;
const all=scene.hand.concat(scene.flight,[scene.target,[0,0,scene.floor],[0,0,1]]);
const lo=[0,1,2].map(i=>Math.min(...all.map(p=>p[i]))),hi=[0,1,2].map(i=>Math.max(...all.map(p=>p[i])));
const mid=lo.map((v,i)=>(v+hi[i])/2),size=Math.hypot(...hi.map((v,i)=>v-lo[i]));
const edges=[];for(let a=0;a<8;a++)for(const b of[1,2,4])if(!(a&b))edges.push([a,a|b]);
function project(p){const x=p[0]-mid[0],y=p[1]-mid[1],z=p[2]-mid[2];
const u=x*Math.cos(az)+y*Math.sin(az),v=-x*Math.sin(az)+y*Math.cos(az);
const k=zoom*0.95*canvas.height/size;return[canvas.width/2+k*u,canvas.height/2-k*(z*Math.cos(el)-v*-Math.sin(el))]}
function path(points,colour,width,dash){g.strokeStyle=colour;g.lineWidth=width;g.setLineDash(dash||[]);g.beginPath();
points.forEach((p,i)=>{const q=project(p);i?g.lineTo(q[0],q[1]):g.moveTo(q[0],q[1])});g.stroke();g.setLineDash([])}
function dot(p,r,colour){const q=project(p);g.fillStyle=colour;g.beginPath();g.arc(q[0],q[1],r,0,7);g.fill()}
function label(p,text){const q=project(p);g.fillStyle='#333';g.font='13px sans-serif';g.fillText(text,q[0]+8,q[1]-6)}
function draw(){g.fillStyle='#fff';g.fillRect(0,0,canvas.width,canvas.height);
for(let i=-2;i<=2;i+=0.5){path([[i,-2,scene.floor],[i,2,scene.floor]],'#eee',1);path([[-2,i,scene.floor],[2,i,scene.floor]],'#eee',1)}
const step=scene.steps[Math.round(slider.value/1000*(scene.steps.length-1))];
for(const b of step.boxes)for(const[a,c]of edges)path([b[a],b[c]],'#7a8899',1);
path(scene.hand,'#0072b2',1.5,[4,3]);path(scene.flight,'#d55e00',2);
const t=scene.target,d=0.06;path([[t[0]-d,t[1],t[2]],[t[0]+d,t[1],t[2]]],'#111',2);path([[t[0],t[1]-d,t[2]],[t[0],t[1]+d,t[2]]],'#111',2);
dot(scene.flight[0],4,'#009e73');dot(step.ball,6,'#d55e00');label(t,'target');label(scene.flight[0],'release');
g.fillStyle='#333';g.font='14px sans-serif';g.fillText('t = '+step.t.toFixed(3)+' s',14,22)}
canvas.onpointerdown=e=>{drag=[e.clientX,e.clientY];canvas.setPointerCapture(e.pointerId)};
canvas.onpointermove=e=>{if(!drag)return;az-=(e.clientX-drag[0])*0.008;el=Math.max(-1.5,Math.min(1.5,el+(e.clientY-drag[1])*0.008));drag=[e.clientX,e.clientY];draw()};
canvas.onpointerup=()=>drag=null;canvas.onwheel=e=>{e.preventDefault();zoom*=Math.exp(-e.deltaY*0.001);draw()};
slider.oninput=draw;slider.value=Math.round(1000*scene.steps.findIndex(s=>Math.hypot(s.ball[0]-scene.flight[0][0],s.ball[1]-scene.flight[0][1],s.ball[2]-scene.flight[0][2])<0.12)/(scene.steps.length-1));draw();
"##;
