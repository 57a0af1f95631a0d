//! What a campaign that measures another one's thresholds has found out.

use std::sync::Arc;

use ::report::HowFar;
use protocol::{CampaignSpec, Rollouts};
use queue::ids::CampaignName;
use queue::read::{Campaign, View};

use super::kept::Made;
use super::problem::Problem;
use super::state::{Found, Page, patience};

impl Page {
    /// What a campaign has found out about another one's thresholds, from results as they
    /// are or as they were a moment ago; none if that is not what it is for.
    pub(super) async fn how_far(
        &self,
        by: &Campaign,
        view: &mut View,
    ) -> Result<Option<Arc<HowFar>>, Problem> {
        let spec = view.spec(by).await?;
        let spec = CampaignSpec::from_json(&spec).map_err(|error| Problem::failed(&error))?;
        let Rollouts::Thresholds(thresholds) = spec.rollouts else {
            return Ok(None);
        };
        let source = CampaignName::parse(&thresholds.campaign);
        let source = source.map_err(|error| Problem::failed(&error))?;
        let source = view.campaign(&source).await?;
        let editions = [view.edition(source.id).await?, view.edition(by.id).await?];
        let is_fresh = |made: &Made<Found>| {
            let mut both = made.value.0.iter().zip(&editions);
            made.value.0 == editions
                || (both.all(|(made, now)| made.is_of_same_campaign(now))
                    && made.at.elapsed() < patience(made.cost))
        };
        let wanted = editions.clone();
        let make = async {
            let documents = [
                self.document(&source, view).await?,
                self.document(by, view).await?,
            ];
            // Thousands of resamplings: not on a thread that answers others.
            let found = tokio::task::spawn_blocking(move || {
                let [source, by] = documents.each_ref().map(|it| &it.analyses[0].subject);
                HowFar::of(source, by, &thresholds)
            });
            let found = found.await.map_err(|error| Problem::failed(&error))?;
            Ok::<_, Problem>((wanted, Arc::new(found)))
        };
        let (_, found) = self.found.get(by.name.as_str(), is_fresh, make).await?;
        Ok(Some(found))
    }
}
