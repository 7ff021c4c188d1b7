//! Levels of sessions that have something in common: levels from their labels.

use crate::analysis::{Options, Row};
use std::collections::{BTreeMap, BTreeSet};

/// Sites from which their differences are a level: two do not say how sites differ.
const MIN_SITES: usize = 3;

/// A group within the groups around it; by the number of its session where that states none.
type Path<'a> = Vec<Result<&'a str, usize>>;

/// The levels of a group of sessions.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Levels {
    /// Their names, outermost first.
    pub names: Vec<String>,
    /// Whether they were chosen, instead of taken from the labels.
    are_chosen: bool,
}

impl Levels {
    /// Those that the user has chosen, or that the labels state: subjects with several sessions, and sites with several
    /// subjects. Remarks for the reader come with the level.
    pub fn choose(rows: &[Row], group: &str, members: &[usize], options: &Options) -> (Self, Vec<String>) {
        let [subjects, sites]: [Vec<Option<&str>>; 2] = ["subject", "site"].map(|name| {
            members.iter().map(|index| rows[*index].labels.get(name).map(String::as_str)).collect()
        });
        let [subject_count, site_count] =
            [&subjects, &sites].map(|labels| labels.iter().flatten().collect::<BTreeSet<_>>().len());
        let stated = subjects.iter().flatten().count();
        let repeated = stated > subject_count;
        let mut warnings = Vec::new();
        if options.independent {
            if repeated {
                warnings.push(format!(
                    "group {group}: {stated} sessions of {subject_count} subjects are taken as independent: intervals are too narrow \
                     where sessions of a subject are alike"
                ));
            }
            return (Self { names: Vec::new(), are_chosen: true }, warnings);
        }
        if !options.nested.is_empty() {
            return (Self { names: options.nested.clone(), are_chosen: true }, warnings);
        }
        let mut names = Vec::new();
        let [is_by_site, is_by_subject] =
            ["site", "subject"].map(|name| options.by.iter().any(|by| by == name));
        let mut of_subject: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (subject, site) in subjects.iter().zip(&sites) {
            if let (Some(subject), Some(site)) = (subject, site) {
                of_subject.entry(subject).or_default().insert(site);
            }
        }
        let several = of_subject.values().filter(|sites| sites.len() > 1).count();
        let of_sites = site_count < sites.iter().flatten().count();
        match site_count {
            _ if is_by_site || !of_sites => {}
            0 | 1 => {}
            _ if several > 0 => warnings.push(format!(
                "group {group}: subjects measured at several sites: {several}; sites are no level of their own (--nested chooses levels)"
            )),
            2 if site_count < MIN_SITES => warnings.push(format!(
                "group {group}: two sites do not determine how sites differ; the mean is of these two (--nested site,subject includes the \
                 level)"
            )),
            _ => names.push("site".to_owned()),
        }
        if repeated && !is_by_subject {
            names.push("subject".to_owned());
        }
        (Self { names, are_chosen: false }, warnings)
    }

    /// Value of a level of a session; `None` where it states none.
    fn value<'a>(&self, row: &'a Row, depth: usize) -> Option<&'a str> {
        if self.are_chosen {
            return row.nested.get(depth)?.as_deref();
        }
        row.labels.get(self.names.get(depth)?).map(String::as_str)
    }

    /// Name of a level, and its value of a session.
    pub fn group<'a>(&'a self, rows: &'a [Row], index: usize, depth: usize) -> (&'a str, &'a str) {
        let name = self.names.get(depth).map_or("", String::as_str);
        (name, self.value(&rows[index], depth).unwrap_or(&rows[index].session))
    }

    /// Number of the group of every session on each level. An inner group is another one in every outer group, and a session that states
    /// none is a group of its own.
    pub fn of(&self, rows: &[Row], members: &[usize]) -> Vec<Vec<usize>> {
        let mut numbers: BTreeMap<Path<'_>, usize> = BTreeMap::new();
        let mut levels = Vec::with_capacity(self.names.len());
        for depth in 0..self.names.len() {
            let groups = members.iter().map(|index| {
                let path = (0..=depth).map(|depth| self.value(&rows[*index], depth).ok_or(*index)).collect();
                let next = numbers.len();
                *numbers.entry(path).or_insert(next)
            });
            levels.push(groups.collect());
        }
        levels
    }
}
